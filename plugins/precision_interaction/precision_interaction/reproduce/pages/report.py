"""The report: pages in Markdown for the documentation, and one HTML file that holds all of it."""

import base64
import html
import os
from collections.abc import Sequence
from pathlib import Path

from precision_interaction.reproduce.pages.page import Page, Presentation, Table, duration
from precision_interaction.reproduce.pages.plotting import save
from precision_interaction.reproduce.row import Setting
from precision_interaction.reproduce.store import Store

TITLE = "The paper, measured again"
INTRODUCTION = (
    "Every figure and table of Xing, Yang, Zhang and Xu on the simulated rig. *Paper* is what is printed, *ideal* what "
    "an analytic controller without spikes reaches, *ours* what the shipped code measured."
)

STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;color:#222;margin:0}"
    "main{max-width:900px;margin:2rem auto;padding:0 1rem}"
    "table{border-collapse:collapse;display:block;overflow-x:auto}"
    "td,th{border-bottom:1px solid #ddd;padding:.3rem .6rem;text-align:left}"
    "img{max-width:100%}figure{margin:1rem 0}figcaption{color:#555}code{background:#f3f3f3}"
)


def write_report(folder: Path, rows: Sequence[tuple[Page, Store]], setting: Setting, command: str) -> Path:
    """Write ``index.md`` with its pictures and ``report.html`` of the rows that are there; return the latter."""
    documents, sections = [_head(setting, command)], [_html_head(setting, command)]
    for page, store in rows:
        shown = page.present(store.results(), setting)
        about = (
            f"`neurorobo reproduce {store.row.name}`: {duration(store.seconds())} of one processor, "
            f"commit {', '.join(store.provenance())}."
        )
        markdown = [f"## {page.paper}: {page.title}", *shown.words]
        section = [
            f"<h2>{html.escape(page.paper)}: {html.escape(page.title)}</h2>",
            *map(_paragraph, shown.words),
        ]
        for table in shown.tables:
            markdown += [_markdown(table), table.caption]
            section += [_html(table), _paragraph(table.caption)]
        for picture in shown.pictures:
            png, svg = save(picture, folder / "figures")
            markdown.append(f"![{picture.caption}](figures/{svg.name})\n\n*{picture.caption}*")
            data = base64.b64encode(png.read_bytes()).decode()
            section.append(
                f'<figure><img alt="{html.escape(picture.caption)}" src="data:image/png;base64,{data}">'
                f"<figcaption>{html.escape(picture.caption)}</figcaption></figure>"
            )
        missed = _missed(shown)
        documents.append("\n\n".join([*markdown, missed, about]))
        sections.append("\n".join([*section, _paragraph(missed), _paragraph(about)]))
    folder.mkdir(parents=True, exist_ok=True)
    _write(folder / "index.md", "\n\n".join(documents) + "\n")
    path = folder / "report.html"
    _write(path, "\n".join(sections) + "\n</main></body></html>\n")
    return path


def _head(setting: Setting, command: str) -> str:
    quick = "\n\n**A trial on a small scale: these figures mean nothing.**" if setting.quick else ""
    return f"# {TITLE}\n\n{INTRODUCTION}{quick}\n\nWritten by `{command}`."


def _html_head(setting: Setting, command: str) -> str:
    quick = "<p><strong>A trial on a small scale: these figures mean nothing.</strong></p>" if setting.quick else ""
    written = _paragraph(f"Written by `{command}`.")
    return (
        f"<!doctype html><html lang=en><head><meta charset=utf-8><title>{TITLE}</title><style>{STYLE}</style></head>"
        f"<body><main><h1>{TITLE}</h1>{_paragraph(INTRODUCTION)}{quick}{written}"
    )


def _missed(shown: Presentation) -> str:
    return "Missed: " + "; ".join(shown.misses) + "." if shown.misses else "Nothing that was wanted is missed."


def _markdown(table: Table) -> str:
    lines = [table.heads, ["---"] * len(table.heads), *table.lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _html(table: Table) -> str:
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in table.heads)
    body = "".join(f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in line)}</tr>" for line in table.lines)
    return f"<table><tr>{head}</tr>{body}</table>"


def _paragraph(words: str) -> str:
    """Return a paragraph of Markdown's plainest: `code` and *emphasis*."""
    parts = html.escape(words).split("`")
    coded = "".join(f"<code>{part}</code>" if i % 2 else _emphasised(part) for i, part in enumerate(parts))
    return f"<p>{coded}</p>"


def _emphasised(words: str) -> str:
    return "".join(f"<em>{part}</em>" if i % 2 else part for i, part in enumerate(words.split("*")))


def _write(path: Path, text: str) -> None:
    draft = path.with_name(path.name + ".tmp")
    draft.write_text(text)
    os.replace(draft, path)
