"""The plan as text: what runs when, on what, from where."""

from collections.abc import Iterator

from neurorobo.graph.plan import Edge, Plan, Repeat, Use
from neurorobo.regions import Port
from neurorobo.units import format_duration


def schedule_lines(plan: Plan) -> Iterator[str]:
    """Yield the lines of the printed schedule: times, the order within a tick, and every edge with its conversion."""
    clock = plan.clock
    tick = format_duration(clock.tick_ns)
    periods = ", ".join(f"{name} {format_duration(period)}" for name, period in clock.periods_ns.items())
    yield f"periods     {periods}"
    yield f"tick        {tick}; the schedule repeats every {plan.hyperperiod} tick{'s' if plan.hyperperiod > 1 else ''}"
    yield f"window      {clock.window} steps of {format_duration(clock.spike_step_ns)}"
    yield ""
    read = sorted({edge.output for edge in plan.outgoing.get("body", ())})
    if read:
        yield f"at each tick: read {', '.join(f'body.{name}' for name in read)}"
    for item in plan.order:
        when = _every(item.period, plan)
        if isinstance(item, Repeat):
            yield f"{when}: repeat {item.count} times"
            for use in item.uses:
                yield from _use_lines(use, "  ")
        else:
            yield from _use_lines(item, "", when)
    for name, edge in plan.command.items():
        yield f"{_every(edge.source_period, plan)}: command {name} <- {_source(edge)}"


def _every(period: int, plan: Plan) -> str:
    if period == 1:
        return "at each tick"
    return f"every {format_duration(period * plan.clock.tick_ns)}"


def _use_lines(use: Use, indent: str, when: str = "") -> Iterator[str]:
    state = {"commit": "", "fork": ", forked state", "fresh": ", fresh state"}[use.policy]
    yield f"{indent}{when}{': ' if when else ''}{use.name} = {use.region}{state}"
    for name, edges in use.inputs.items():
        sources = ", ".join(_source(edge) for edge in edges)
        yield f"{indent}    {name} <- {sources}"
    for name, port in use.defaults.items():
        yield f"{indent}    {name} <- its initial value {_initial(port)}"


def _source(edge: Edge) -> str:
    if not edge.conversion:
        return edge.wording
    source, reader = edge.source_port, edge.reader_port
    forms = [f"{port.channels} neurons" if port.code else f"{port.width} x {port.unit}" for port in (source, reader)]
    return f"{edge.wording} [{edge.conversion}: {forms[0]} -> {forms[1]}]"


def _initial(port: Port) -> str:
    return f"({', '.join(f'{value:g}' for value in port.initial or ())}) {port.unit}"
