"""The command ``neurorobo reproduce``."""

import signal
import time
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path

import click

from neurorobo.errors import NeuroroboError
from precision_interaction.reproduce.pages.every import pages
from precision_interaction.reproduce.pages.page import duration
from precision_interaction.reproduce.row import Result, Row, Setting
from precision_interaction.reproduce.store import Store, as_json

Measured = tuple[Result, float]
"""A result, and the seconds of processor time that it took."""

Waiting = tuple[Store, str]
"""A cell that is to be measured."""


@click.command()
@click.argument("names", nargs=-1, metavar="[ROW]...")
@click.option("--quick", is_flag=True, help="Try everything on a small scale; the figures mean nothing.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of the results and the report. Default: runs/reproduce, or runs/reproduce-quick.",
)
@click.option(
    "--examples",
    default=Path("examples"),
    show_default=True,
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of the example experiments.",
)
@click.option("--jobs", default=2, show_default=True, type=click.IntRange(1), help="Processes, of one thread each.")
@click.option("--list", "list_rows", is_flag=True, help="List the rows and stop.")
def reproduce(
    names: tuple[str, ...], quick: bool, out: Path | None, examples: Path, jobs: int, list_rows: bool
) -> None:
    """Measure the paper's figures and tables again and write a report.

    Results are kept cell by cell in the folder --out, and are measured again only when the code or the configuration
    that they depend on has changed; stopped at any time, the same command goes on.
    """
    known = {page.row.name: page for page in pages()}
    if list_rows:
        for name, page in known.items():
            click.echo(f"{name:12} {duration(60 * page.minutes):>12}  {page.paper:22} {page.title}")
        return
    if unknown := [name for name in names if name not in known]:
        raise NeuroroboError(f"there is no row `{unknown[0]}`; there are: {', '.join(known)}")
    if not (examples / "peg_in_hole.yaml").exists():
        raise NeuroroboError(f"{examples} holds no peg_in_hole.yaml; run this in the repository, or give --examples")
    if find_spec("matplotlib") is None:
        raise NeuroroboError(
            "the report's pictures need matplotlib; pip install 'neurorobo-precision-interaction[report]'"
        )
    chosen = [known[name] for name in names] if names else list(known.values())
    for page in chosen:
        if page.package is not None and find_spec(page.package) is None:
            raise NeuroroboError(
                f"the row `{page.row.name}` needs {page.package}; "
                f"pip install 'neurorobo-precision-interaction[{page.package}]', or name the other rows"
            )
    folder = out or Path("runs") / ("reproduce-quick" if quick else "reproduce")
    setting = Setting(examples.resolve(), quick)
    stores = [Store(folder / "results", page.row, setting) for page in chosen]
    measure_missing(stores, setting, jobs)
    from precision_interaction.reproduce.pages.report import write_report

    words = "neurorobo reproduce" + (" --quick" if quick else "") + ("" if out is None else f" --out {out}")
    every = [(page, Store(folder / "results", page.row, setting)) for page in known.values()]
    there = [(page, store) for page, store in every if store.whole]
    for _, store in there:
        if store.missing():
            click.echo(f"note: {store.file} is of other code or settings than these; `{words}` measures it", err=True)
    path = write_report(folder, there, setting, words)
    click.echo(str(path))


def measure_missing(stores: Sequence[Store], setting: Setting, jobs: int) -> None:
    """Measure all cells that are missing, and keep each as soon as it is there; several at once, or here with one job.

    Raises what a cell does; all others that were finished are kept. A KeyboardInterrupt says how many there are.
    """
    waiting = [(store, cell) for store in stores for cell in store.missing()]
    cells = sum(len(store.row.cells(setting)) for store in stores)
    if waiting and (before := cells - len(waiting)):
        click.echo(f"{before} of {cells} cells are there from before; to be measured: {len(waiting)}", err=True)
    started, done = time.monotonic(), 0
    measured = _here(waiting, setting) if jobs == 1 else _side_by_side(waiting, setting, jobs)
    try:
        with closing(measured):
            for (store, cell), (result, seconds) in measured:
                store.add(cell, result, seconds)
                done += 1
                minutes = (time.monotonic() - started) / 60
                words = f"{store.row.name}, {cell}: {seconds:.0f} s  ({minutes:.1f} min so far)"
                click.echo(f"{done} of {len(waiting)}: {words}", err=True)
    except KeyboardInterrupt:
        kept, folder = cells - len(waiting) + done, waiting[0][0].folder
        raise KeyboardInterrupt(
            f"{kept} of {cells} cells are kept in {folder}; the same command goes on from there"
            if kept
            else "no cell was finished yet"
        ) from None


def _here(waiting: Sequence[Waiting], setting: Setting) -> Generator[tuple[Waiting, Measured]]:
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # as in other processes: sums of several threads may differ in their last bits
    try:
        for one in waiting:
            yield one, _measure(type(one[0].row), one[1], setting)
    finally:
        torch.set_num_threads(threads)


def _side_by_side(waiting: Sequence[Waiting], setting: Setting, jobs: int) -> Generator[tuple[Waiting, Measured]]:
    """Yield what is measured, in the order in which it ends; processes end with this generator."""
    with ProcessPoolExecutor(min(jobs, max(1, len(waiting))), get_context("spawn"), _begin) as pool:
        with _not_interrupted():  # processes inherit it, and are not torn out of their imports by Ctrl-C
            futures = {pool.submit(_measure, type(one[0].row), one[1], setting): one for one in waiting}
        try:
            for future in as_completed(futures):
                store, cell = futures[future]
                try:
                    yield futures[future], future.result()
                except BrokenProcessPool:
                    fault = f"{store.row.name}, {cell}: the process ended; is there enough memory?"
                    raise NeuroroboError(fault) from None
        except BaseException:
            processes = list((pool._processes or {}).values())  # the pool forgets them as it shuts down
            pool.shutdown(wait=False, cancel_futures=True)
            for process in processes:
                process.terminate()
            raise


@contextmanager
def _not_interrupted() -> Iterator[None]:
    """Ignore Ctrl-C while the block runs, and in processes that it starts; Ctrl-C is for the parent."""
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)


def _begin() -> None:
    """Prepare a process: one thread."""
    import torch

    torch.set_num_threads(1)


def _measure(kind: type[Row], cell: str, setting: Setting) -> Measured:
    started = time.process_time()
    result = as_json(kind().measure(cell, setting))
    return result, time.process_time() - started
