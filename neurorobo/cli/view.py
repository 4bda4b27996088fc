"""The view command: opens the recording of a run."""

from pathlib import Path

import click


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--web", is_flag=True, help="Serve the viewer to a browser on this machine instead of opening a window.")
@click.option("--port", default=9090, show_default=True, type=click.IntRange(1, 65534), help="Port of the web viewer.")
def view(run: Path, web: bool, port: int) -> None:
    """Open the recording of RUN: a run folder or an .rrd file."""
    import subprocess
    import sys

    from neurorobo.errors import NeuroroboError

    recording = run / "recording.rrd" if run.is_dir() else run
    if not recording.is_file():
        raise NeuroroboError(f"there is no recording {recording}; run an experiment whose `record` lists `rerun`")
    command = [sys.executable, "-m", "rerun", str(recording), "--bind", "127.0.0.1"]
    if web:
        command += ["--serve-web", "--web-viewer-port", str(port), "--port", str(port + 1)]
        click.echo(f"serving on http://127.0.0.1:{port}; stop with Ctrl-C")
    code = subprocess.run(command, check=False).returncode
    if code != 0:
        raise NeuroroboError(f"the viewer ended with code {code}; without a display, try `neurorobo view --web {run}`")
