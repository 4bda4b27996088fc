"""The region graph as a Mermaid flowchart."""

from collections.abc import Iterator

from neurorobo.graph.compile import BODY, COMMAND
from neurorobo.graph.plan import Edge, Plan, Repeat


def mermaid_lines(plan: Plan) -> Iterator[str]:
    """Yield the lines of a flowchart.

    Steps are boxes, repeats frames; edges are labelled with port and unit, and dotted if they read the past.
    """
    yield "flowchart LR"
    if "body" in plan.outgoing:
        yield '  sensors(["body"])'
    for i, item in enumerate(plan.order):
        if isinstance(item, Repeat):
            yield f'  subgraph repeat{i}["{item.count} times"]'
            for use in item.uses:
                yield f"    {_node(use.name, use.region)}"
            yield "  end"
        else:
            yield f"  {_node(item.name, item.region)}"
    if plan.command:
        yield '  actuators(["body"])'
    for edge in plan.edges():
        yield f"  {_id(edge.source)} {_arrow(edge)}|{edge.output} {edge.source_port.unit}| {_id(edge.reader)}"


def _node(name: str, region: str) -> str:
    label = name if name == region else f"{name}<br/><i>{region}</i>"
    return f'{_id(name)}["{label}"]'


def _id(name: str) -> str:
    """Return the name of a node; a bare step could be a word of Mermaid's, such as ``style`` or ``end``."""
    return {BODY: "sensors", COMMAND: "actuators"}.get(name, f"step_{name}")


def _arrow(edge: Edge) -> str:
    past = edge.delay or edge.skip_this_tick or edge.restarts_in_repeat or not edge.source_runs_first
    return "-.->" if past else "-->"
