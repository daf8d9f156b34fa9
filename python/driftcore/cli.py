"""The `driftcore` command: parses, calls, saves; holds no science."""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
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

from driftcore.errors import DriftCoreError, DriftCoreWarning, OutputError

if TYPE_CHECKING:
    from driftcore.forecast import Forecast

app = typer.Typer(
    help="Where will something adrift on the sea be, weeks to months ahead? "
    "Probabilities, from many simulated winds.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
out = Console(highlight=False)
err = Console(stderr=True, highlight=False)

Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace files that exist.")]
Threads = Annotated[int | None, typer.Option(min=1, help="Threads; default all processors.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar, no summary.")]


@app.command(rich_help_panel="Forecast")
def demo(
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for the NetCDF file and the figures.")
    ] = Path("driftcore-demo"),
    members: Annotated[int, typer.Option(help="Number of simulated winds.")] = 1000,
    seed: Annotated[int, typer.Option(help="Names the winds drawn.")] = 1,
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
        sys.stdout.write(configuration.to_toml())
        return
    from driftcore.files import check_writable

    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{output}: cannot be made a folder: {error.strerror}") from None
    path = output / "demo.nc"
    check_writable(path, overwrite)
    forecast = _run(configuration, Path(), threads, quiet)
    forecast.to_netcdf(path, overwrite)
    written = [path, *_plots(forecast, output, overwrite)]
    written += _member_plots(forecast, output, overwrite)
    if not quiet:
        _summary(forecast)
        _say_written(written)


@app.command(rich_help_panel="Forecast")
def run(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (TOML).")],
    output: Annotated[Path, typer.Option("--output", "-o", help="NetCDF file to write.")],
    threads: Threads = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the result as JSON instead of a table.")
    ] = False,
) -> None:
    """Run the forecast that a scenario file describes.

    `driftcore demo --print-scenario > my.toml` gives a file to start from, with every number of
    the paper's case. Relative paths in it start at the folder it lies in.
    """
    from driftcore.files import check_writable
    from driftcore.scenario import RunConfiguration

    configuration = RunConfiguration.from_toml(scenario)
    check_writable(output, overwrite)
    forecast = _run(configuration, scenario.parent, threads, quiet or as_json)
    forecast.to_netcdf(output, overwrite)
    if as_json:
        sys.stdout.write(json.dumps(_result(forecast)) + "\n")
    elif not quiet:
        _summary(forecast)
        _say_written([output])


@app.command(rich_help_panel="Results")
def plot(
    forecast: Annotated[Path, typer.Argument(help="Forecast file (NetCDF).")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder for the figures; default that of the file."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Draw the figures of a forecast: trajectories, roses, stranding times."""
    from driftcore.forecast import open_forecast

    folder = forecast.parent if output is None else output
    _say_written(_plots(open_forecast(forecast), folder, overwrite))


@app.command(rich_help_panel="Results")
def validate(
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="JSON file for the numbers.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Measure the errors of the averaged models against the full one, beside what is required.

    Exit code 1 if a measured error is larger than required.
    """
    from driftcore import paper
    from driftcore.files import check_writable, replacing

    if output is not None:
        check_writable(output, overwrite)
    checks = paper.validation()
    table = Table("what", "measured", "required", "", title="Sup-errors over the run")
    for check in checks:
        verdict = "[green]ok[/]" if check.passed else "[red]too large[/]"
        table.add_row(check.name, f"{check.measured:.3g}", f"≤ {check.required:.3g}", verdict)
    out.print(table)
    if output is not None:
        numbers = [{**vars(check), "passed": check.passed} for check in checks]
        with replacing(output, overwrite) as temporary:
            temporary.write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
    if not all(check.passed for check in checks):
        raise typer.Exit(1)


def _run(configuration: Any, folder: Path, threads: int | None, quiet: bool) -> Forecast:
    from driftcore.forecast import run as run_configuration

    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("members"),
        TimeRemainingColumn(),
        console=err,
        disable=quiet,
        transient=True,
    )
    with bar:
        task = bar.add_task("fitting the wind", total=None)

        def progress(done: int, members: int) -> None:
            bar.update(task, description="following", completed=done, total=members)

        return run_configuration(configuration, folder=folder, threads=threads, progress=progress)


def _plots(forecast: Forecast, folder: Path, overwrite: bool) -> list[Path]:
    from driftcore import plot as figures

    return figures.save_all(forecast.dataset, folder, overwrite)


def _member_plots(forecast: Forecast, folder: Path, overwrite: bool) -> list[Path]:
    from driftcore import plot as figures
    from driftcore.forecast import member_trajectories

    return figures.save_member(*member_trajectories(forecast), folder, overwrite)


def _result(forecast: Forecast) -> dict[str, Any]:
    p = forecast.stranding_probability()
    quantiles = forecast.stranding_time_quantiles().values
    attributes = forecast.dataset.attrs
    return {
        "stranding_probability": p.estimate,
        "low": p.low,
        "high": p.high,
        "level": p.level,
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
    table.add_row("wind", attributes["wind_label"])
    table.add_row("model", f"{result['model']}{order}, seed {result['seed']}")
    table.add_row(
        "run",
        f"{attributes['members']} members, {attributes['duration'] * days_per_unit:.1f} days",
    )
    table.add_row(
        "strands",
        f"[bold]{result['stranding_probability']:.3f}[/]  "
        f"(95 % interval {result['low']:.3f} to {result['high']:.3f})",
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
        table.add_row("where", ", ".join(f"{name} {share:.3f}" for share, name in ranked))
    for name in ("left_domain", "failed"):
        if result[name]:
            table.add_row(name.replace("_", " "), f"{result[name]} members")
    out.print(table)


def _say_written(paths: list[Path]) -> None:
    for path in paths:
        out.print(f"wrote {path}", soft_wrap=True)


@contextmanager
def _spoken_warnings() -> Iterator[None]:
    """Print driftcore's warnings as one line each, at once."""
    with warnings.catch_warnings():
        plain = warnings.showwarning

        def show(message: Any, category: Any, *rest: Any, **more: Any) -> None:
            if issubclass(category, DriftCoreWarning):
                err.print(f"[yellow]warning:[/] {escape(str(message))}", soft_wrap=True)
            else:
                plain(message, category, *rest, **more)

        warnings.showwarning = show
        warnings.simplefilter("always", DriftCoreWarning)
        yield


def main() -> None:
    """Entry point: exit code 2 and one line for what the user can mend, 130 when interrupted."""
    try:
        with _spoken_warnings():
            app()
    except DriftCoreError as error:
        err.print(f"[red]error:[/] {escape(str(error))}", soft_wrap=True)
        sys.exit(2)
    except KeyboardInterrupt:
        err.print("interrupted; nothing was written")
        sys.exit(130)
