"""The region graph as a Mermaid flowchart."""

from collections.abc import Iterator

from neurorobo.graph.plan import Edge, Plan, Repeat


def mermaid_lines(plan: Plan) -> Iterator[str]:
    """Yield a flowchart: steps as boxes, repeats as frames, edges labelled with port and unit, dotted if they read
    the past."""
    yield "flowchart LR"
    if "body" in plan.outgoing:
        yield '  body(["body"])'
    for i, item in enumerate(plan.order):
        if isinstance(item, Repeat):
            yield f'  subgraph repeat{i}["{item.count} times"]'
            for use in item.uses:
                yield f"    {_node(use.name, use.region)}"
            yield "  end"
        else:
            yield f"  {_node(item.name, item.region)}"
    if plan.command:
        yield '  command(["body"])'
    for edge in plan.edges():
        yield f"  {_id(edge.source)} {_arrow(edge)}|{edge.output} {edge.source_port.unit}| {_id(edge.reader)}"


def _node(name: str, region: str) -> str:
    label = name if name == region else f"{name}<br/><i>{region}</i>"
    return f'{_id(name)}["{label}"]'


def _id(name: str) -> str:
    return f"step_{name}" if name in ("end", "graph", "subgraph") else name


def _arrow(edge: Edge) -> str:
    past = edge.delay or edge.skip_this_tick or edge.restarts_in_repeat or not edge.source_runs_first
    return "-.->" if past else "-->"
