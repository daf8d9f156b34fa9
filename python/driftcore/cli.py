"""The `driftcore` command: parses, calls, saves; holds no science."""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from typer.core import TyperGroup

from driftcore import __version__
from driftcore.errors import DriftCoreError, DriftCoreWarning, RecordError

if TYPE_CHECKING:
    from driftcore.forecast import Forecast

out = Console(highlight=False)
err = Console(stderr=True, highlight=False)


class Commands(TyperGroup):
    """Says what an interruption left, which typer would pass over in silence."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command that was asked for."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            err.print("interrupted; nothing was written")
            raise typer.Exit(130) from None


app = typer.Typer(
    cls=Commands,
    help="Where will something adrift on the sea be, weeks to months ahead?\n\n"
    "Probabilities, from many simulated winds. To begin: `driftcore demo`.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)

Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace files that exist.")]
Threads = Annotated[int | None, typer.Option(min=1, help="Threads; default all processors.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar, no summary.")]


def _say_version(asked: bool) -> None:
    if asked:
        sys.stdout.write(f"driftcore {__version__}\n")
        raise typer.Exit


@app.callback()
def about(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version, and stop.", callback=_say_version),
    ] = False,
) -> None:
    """Hold the options that stand before a command."""


@app.command(rich_help_panel="Forecast")
def demo(
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for the NetCDF file and the figures.")
    ] = Path("driftcore-demo"),
    members: Annotated[int, typer.Option(help="Number of simulated winds.")] = 1000,
    seed: Annotated[
        int, typer.Option(help="Names the winds: the same seed, the same forecast.")
    ] = 1,
    print_scenario: Annotated[
        bool,
        typer.Option("--print-scenario", help="Print the scenario file of the demo, and stop."),
    ] = False,
    threads: Threads = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Run the paper's forecast on the embedded synthetic wind.

    An object is adrift for 26 days under tide and wind inside a circular coast. The probability
    that it runs aground, where and when, is printed; the whole forecast and its figures are
    written to a folder.
    """
    from driftcore.scenario import EnsembleConfiguration, RunConfiguration

    configuration = RunConfiguration(ensemble=EnsembleConfiguration(members=members, seed=seed))
    if print_scenario:
        # Bytes, for TOML is UTF-8 whatever the terminal's encoding.
        typer.echo(configuration.to_toml().encode(), nl=False)
        return
    from driftcore import plot as figures
    from driftcore.files import filling
    from driftcore.forecast import member_trajectories

    with filling(output, overwrite, expected="demo.nc") as folder:
        forecast = _run(configuration, Path(), threads, quiet)
        forecast.to_netcdf(folder / "demo.nc")
        written = [
            folder / "demo.nc",
            *figures.save_all(forecast.dataset, folder),
            *figures.save_member(*member_trajectories(forecast), folder),
        ]
    if not quiet:
        _summary(forecast)
        _say_written([output / path.name for path in written])


@app.command(rich_help_panel="Forecast")
def run(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO", help="Scenario file (TOML).")],
    output: Annotated[Path, typer.Option("--output", "-o", help="NetCDF file to write.")],
    threads: Threads = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the result as JSON instead of a table.")
    ] = False,
) -> None:
    """Run the forecast that a scenario file describes.

    To start from the paper's case, with every number explained:
    `driftcore demo --print-scenario > my.toml`. A relative path of a wind record starts at the
    folder of the scenario file.
    """
    from driftcore.files import check_writable
    from driftcore.scenario import RunConfiguration

    configuration = RunConfiguration.from_toml(scenario)
    check_writable(output, overwrite)
    # The forecast records its wind by this path: absolute, it can be run again from anywhere.
    forecast = _run(configuration, scenario.parent.resolve(), threads, quiet or as_json)
    forecast.to_netcdf(output, overwrite)
    if as_json:
        sys.stdout.write(json.dumps(_result(forecast)) + "\n")
    elif not quiet:
        _summary(forecast)
        _say_written([output])


@app.command(rich_help_panel="Results")
def plot(
    forecast: Annotated[Path, typer.Argument(metavar="FORECAST", help="Forecast file (NetCDF).")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder for the figures; default that of the file."),
    ] = None,
    overwrite: Overwrite = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Do not list the files written.")
    ] = False,
) -> None:
    """Draw the figures of a forecast: trajectories, roses, stranding times."""
    from driftcore import plot as figures
    from driftcore.files import filling
    from driftcore.forecast import open_forecast

    dataset = open_forecast(forecast).dataset
    target = forecast.parent if output is None else output
    with filling(target, overwrite) as folder:
        written = figures.save_all(dataset, folder)
    if not quiet:
        _say_written([target / path.name for path in written])


@app.command(rich_help_panel="Results")
def validate(
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder for the report, its numbers and figures."),
    ] = None,
    full: Annotated[
        bool, typer.Option("--full", help="More winds and smaller steps; takes longer.")
    ] = False,
    record: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Wind record (CSV or NetCDF) whose law is measured beside the embedded one's.",
        ),
    ] = None,
    months: Annotated[
        str | None,
        typer.Option(metavar="LIST", help="Its months, or `all`; default 6,7,8."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Measure the models against each other and the paper's tables, beside what is required.

    Takes minutes. Exit code 1 if a number is not as required. A record needs at least six seasons.
    """
    from driftcore import validation
    from driftcore.files import filling
    from driftcore.record import read_record
    from driftcore.validation_report import REPORT, write

    effort = validation.FULL if full else validation.DEFAULT
    if record is None and months is not None:
        raise RecordError("months: they are those of a record; name it by --record")
    wind = None if record is None else read_record(record, _months(months or "6,7,8"))
    with ExitStack() as stack:
        # Before the work, so that a folder that cannot be written costs none.
        folder = output and stack.enter_context(filling(output, overwrite, expected=REPORT))
        with err.status("") as status:
            measured = validation.measure(
                effort, lambda part: status.update(f"measuring {part}"), wind
            )
            if folder is not None:
                status.update("writing the report")
                write(measured, folder)
    table = Table("what", "measured", "required", "")
    for check in measured.checks:
        verdict = "[green]ok[/]" if check.passed else "[red]not met[/]"
        table.add_row(check.name, f"{check.measured:.4g}", check.required, verdict)
    out.print(table)
    if output is not None:
        _say_written([output / REPORT])
    if not measured.passed:
        raise typer.Exit(1)


def _months(words: str) -> list[int] | None:
    if words == "all":
        return None
    try:
        return [int(word) for word in words.split(",")]
    except ValueError:
        raise RecordError(
            f"months: {words!r} is not accepted; use numbers from 1 to 12, like 6,7,8, or all"
        ) from None


def _run(configuration: Any, folder: Path, threads: int | None, quiet: bool) -> Forecast:
    from driftcore.forecast import run as run_configuration

    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("members"),
        TimeRemainingColumn(),
        console=err,
        disable=quiet or not err.is_terminal,
        transient=True,
    )
    with bar:
        task = bar.add_task("fitting the wind", total=None)

        def progress(done: int, members: int) -> None:
            bar.update(task, description="following", completed=done, total=members)

        return run_configuration(configuration, folder=folder, threads=threads, progress=progress)


def _result(forecast: Forecast) -> dict[str, Any]:
    # Without a member that could be followed there is no probability.
    p = forecast.stranding_probability() if forecast.followed else None
    quantiles = forecast.stranding_time_quantiles().values
    attributes = forecast.dataset.attrs
    return {
        "stranding_probability": p and p.estimate,
        "low": p and p.low,
        "high": p and p.high,
        "level": p and p.level,
        **forecast.counts,
        "stranding_time_quantiles": {
            str(q): None if t != t else float(t)
            for q, t in zip((0.05, 0.5, 0.95), quantiles, strict=True)
        },
        "model": attributes["model"],
        "seed": int(attributes["seed"]),
        "wind": attributes["wind_label"],
    }


def _summary(forecast: Forecast) -> None:
    result = _result(forecast)
    attributes = forecast.dataset.attrs
    days_per_unit = attributes["tide_period_h"] / attributes["epsilon"] / 24
    order = f", order {attributes['order']}" if "order" in attributes else ""
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_row("wind", escape(attributes["wind_label"]))
    table.add_row("model", f"{result['model']}{order}, seed {result['seed']}")
    table.add_row(
        "run",
        f"{attributes['members']} members, {attributes['duration'] * days_per_unit:.1f} days",
    )
    if forecast.followed:
        table.add_row(
            "strands",
            f"[bold]{result['stranding_probability']:.3f}[/]  "
            f"({result['level'] * 100:.0f} % interval {result['low']:.3f} to {result['high']:.3f})",
        )
    early, middle, late = result["stranding_time_quantiles"].values()
    if middle is not None:
        table.add_row(
            "when",
            f"median {middle * days_per_unit:.1f} days; nine in ten between "
            f"{early * days_per_unit:.1f} and {late * days_per_unit:.1f}",
        )
        sectors = forecast.stranding_by_sector(8)["probability"].values
        names = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
        ranked = sorted(zip(sectors, names, strict=True), reverse=True)[:3]
        table.add_row("where", ", ".join(f"{name} {share:.3f}" for share, name in ranked if share))
    for name in ("left_domain", "failed"):
        if result[name]:
            table.add_row(name.replace("_", " "), f"{result[name]} members")
    out.print(table)


def _say_written(paths: list[Path]) -> None:
    for path in paths:
        out.print(f"wrote {escape(str(path))}", soft_wrap=True)


def _say(colour: str, kind: str, message: str) -> None:
    err.print(f"[{colour}]{kind}:[/] {escape(message)}", soft_wrap=True)


@contextmanager
def _spoken_warnings() -> Iterator[None]:
    """Print driftcore's warnings as one line each, at once."""
    with warnings.catch_warnings():
        plain = warnings.showwarning

        def show(message: Any, category: Any, *rest: Any, **more: Any) -> None:
            if issubclass(category, DriftCoreWarning):
                _say("yellow", "warning", str(message))
            else:
                plain(message, category, *rest, **more)

        warnings.showwarning = show
        warnings.simplefilter("always", DriftCoreWarning)
        yield


def main() -> None:
    """Entry point: exit code 2 and one line for what the user can mend, 130 when interrupted."""
    if isinstance(sys.stdout, TextIOWrapper):
        # A name that the terminal's encoding lacks a letter of is no reason to stop.
        sys.stdout.reconfigure(errors="replace")
    try:
        with _spoken_warnings():
            app(prog_name="driftcore")
    except DriftCoreError as error:
        # Messages of the libraries beneath may hold line breaks.
        _say("red", "error", " ".join(str(error).split()))
        sys.exit(2)
    except MemoryError:
        _say("red", "error", "out of memory; fewer members, or fewer of them kept, need less")
        sys.exit(2)
