"""The `driftcore` command: parses, calls, saves; holds no science."""

from __future__ import annotations

import json
import math
import signal
import sys
import threading
import warnings
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from functools import partial
from io import TextIOWrapper
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text
from typer.core import TyperGroup

from driftcore import __version__
from driftcore.coast import place_name
from driftcore.errors import DriftCoreError, DriftCoreWarning, RecordError, ScenarioError
from driftcore.words import how, set_up

if TYPE_CHECKING:
    from driftcore.coast import LandCoast
    from driftcore.results import Forecast

out = Console(highlight=False)
err = Console(stderr=True, highlight=False)


class Commands(TyperGroup):
    """Says what an interruption left, which typer would pass over in silence."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command that was asked for."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as cause:
            ended = isinstance(cause, Terminated)
            left = str(cause) or "nothing was written"
            err.print(f"{'terminated' if ended else 'interrupted'}; {escape(left)}", soft_wrap=True)
            raise typer.Exit(143 if ended else 130) from None


class Terminated(KeyboardInterrupt):
    """The process was asked to end, by SIGTERM."""


def _terminate(*_: object) -> None:
    raise Terminated


app = typer.Typer(
    cls=Commands,
    help="Where will something adrift on the sea be, weeks to months ahead?\n\n"
    "Probabilities, from many simulated winds. To begin: `driftcore demo`.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)

Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace files that exist.")]
Threads = Annotated[int | None, typer.Option(min=1, help="Threads; default all processors.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar, no summary.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
ScenarioFile = Annotated[Path, typer.Argument(metavar="SCENARIO", help="Scenario file (TOML).")]
Silent = Annotated[bool, typer.Option("--quiet", "-q", help="Do not list the files written.")]
Coast = Annotated[
    Path | None,
    typer.Option(help="Land to draw on the real sea; default that of the scenario."),
]
ForecastFile = Annotated[Path, typer.Argument(metavar="FORECAST", help="Forecast (.nc or .zarr).")]

# Members followed to estimate what all of them cost: a few, which makes everything ready; then more
# and more, until following them takes long enough [s] to be measured.
_FEW, _TIMES_MORE, _LONG_ENOUGH = 32, 8, 0.25
# The coast of the package, as scenario files call it.
_LAND = "natural-earth"
# Stretches of coast shown.
_STRETCHES = 5


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
    as_json: AsJson = False,
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
    from driftcore.trajectories import member_trajectories

    with filling(output, overwrite, expected="demo.nc") as folder:
        forecast = _run(configuration, Path(), threads, quiet or as_json)
        forecast.to_netcdf(folder / "demo.nc")
        written = [
            folder / "demo.nc",
            *figures.save_all(forecast.dataset, folder),
            *figures.save_member(*member_trajectories(forecast), folder),
        ]
    files = [output / path.name for path in written]
    if as_json:
        _print_json({**_result(forecast), "files": [str(path) for path in files]})
    elif not quiet:
        _summary(forecast)
        _say_written(files)


@app.command(rich_help_panel="Forecast")
def run(
    scenario: ScenarioFile,
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", help="NetCDF file to write, or a store for long runs (.zarr)."
        ),
    ],
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with a store that is unfinished.")
    ] = False,
    chunk: Annotated[
        int | None, typer.Option(min=1, help="Members in each chunk of a store.")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Let the workers of this dask scheduler follow."),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Let so many dask workers of this machine follow.")
    ] = None,
    threads: Threads = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Run the forecast that a scenario file describes.

    A file to start from, with every number explained: `driftcore new my.toml`. Relative paths in
    it start at its folder. A store (.zarr) is written chunk by chunk: memory does not grow with
    the number of members, and what is finished outlives any interruption.
    """
    from driftcore.files import check_writable
    from driftcore.geographic_configuration import read_configuration

    configuration = read_configuration(scenario)
    # The forecast records its wind by this path: absolute, it can be run again from anywhere.
    folder, quiet_bar = scenario.parent.resolve(), quiet or as_json
    if output.suffix == ".zarr":
        how: dict[str, Any] = {"resume": resume, "overwrite": overwrite, "chunk": chunk}
        try:
            with ExitStack() as stack:
                if scheduler is not None or workers is not None:
                    from driftcore.distributed import connected

                    how["client"] = stack.enter_context(connected(scheduler, workers))
                forecast = _run(configuration, folder, threads, quiet_bar, store=output, **how)
        except KeyboardInterrupt as cause:
            again = f"driftcore run {scenario} -o {output} --resume"
            raise type(cause)(f"what is finished is kept: {again}") from None
    else:
        for name, value in {
            "resume": resume,
            "chunk": chunk,
            "scheduler": scheduler,
            "workers": workers,
        }.items():
            if value:
                raise ScenarioError(
                    f"--{name}: is of a store; name one that ends in .zarr, not {output.name}"
                )
        check_writable(output, overwrite)
        if output.suffix.lower() != ".nc":
            raise ScenarioError(
                f"--output: '{output}' is not accepted; a name that ends in .nc, or .zarr for a "
                "store. Other formats: driftcore export"
            )
        forecast = _run(configuration, folder, threads, quiet_bar)
        forecast.to_netcdf(output, overwrite)
    if as_json:
        sys.stdout.write(json.dumps(_result(forecast)) + "\n")
    elif not quiet:
        _summary(forecast)
        _say_written([output])


@app.command(rich_help_panel="Forecast")
def check(
    scenario: ScenarioFile,
    threads: Threads = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Warnings alone: the exit code tells.")
    ] = False,
    as_json: AsJson = False,
    picture: Annotated[
        Path | None,
        typer.Option("--plot", metavar="PNG", help="Draw what is set up into this file."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Check a scenario file, say what it sets up, and estimate what the run costs.

    Everything is read, the wind is fitted, and a few members are followed.
    """
    from driftcore.geographic_configuration import GeographicConfiguration, read_configuration
    from driftcore.members import default_threads
    from driftcore.precision import FIRST_LOOK, PRECISION
    from driftcore.runs import planned
    from driftcore.statistics import members_needed

    if picture is not None:
        from driftcore.drawing import check_picture

        check_picture(picture, overwrite)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DriftCoreWarning)
        configuration = read_configuration(scenario)
        wanted = configuration.ensemble
        with err.status("reading, fitting the wind, following a few members"):
            start = perf_counter()
            follow = planned(configuration, scenario.parent.resolve())
            reading = perf_counter() - start
            follow = partial(follow, precision=None, threads=threads)
            if wanted.members == "auto":
                # As far as a few tell.
                p = follow(members=_FEW * _TIMES_MORE, keep=0).stranding_probability()
                precision = wanted.precision or PRECISION
                whole = max(FIRST_LOOK, members_needed((p.low + p.high) / 2, precision))
            else:
                whole = wanted.members
            numbers: list[int] = []
            times: list[float] = []
            sizes: list[int] = []
            while len(times) < 2 or (times[-1] < _LONG_ENOUGH and numbers[-1] < whole):
                members = min(whole, _FEW * _TIMES_MORE ** len(numbers))
                start = perf_counter()
                keep = round(members * min(1, wanted.keep / whole))
                forecast = follow(members=members, keep=keep)
                times.append(perf_counter() - start)
                numbers.append(members)
                sizes.append(forecast.dataset.nbytes)
            if picture is not None:
                from driftcore.drawing import save_figures
                from driftcore.plot_setup import set_up as draw_set_up

                given = follow.keywords
                sea, winds = follow.args
                drawn: Any = draw_set_up(sea, winds, given["maps"], given["targets"])
                save_figures({picture.stem: drawn[0].figure}, picture.parent, overwrite)
    told = [str(w.message) for w in caught if issubclass(w.category, DriftCoreWarning)]
    if isinstance(configuration, GeographicConfiguration):
        told += configuration.doubts()
    told = list(dict.fromkeys(told))
    each = times[-1] / numbers[-1]
    size = (sizes[-1] - sizes[0]) / max(1, numbers[-1] - numbers[0])
    preparation = reading + max(0.0, times[0] - each * numbers[0])
    seconds = preparation + each * whole
    megabytes = (sizes[-1] + size * (whole - numbers[-1])) / 1e6
    estimate = {
        "members": whole,
        "threads": threads or default_threads(),
        "preparation_s": preparation,
        "seconds": seconds,
        "members_per_second": 1 / each,
        "megabytes": megabytes,
    }
    if as_json:
        about = {"attributes": _attributes(forecast), "estimate": estimate, "warnings": told}
        sys.stdout.write(json.dumps(about) + "\n")
        return
    table = _rows([*set_up(forecast), *how(forecast)])
    at_precision = " or so, as precision takes" if wanted.members == "auto" else ""
    table.add_row(
        "cost",
        f"{whole} members{at_precision}: about {_duration(seconds)} on "
        f"{estimate['threads']} threads, {max(1, round(megabytes))} MB",
    )
    if not quiet:
        out.print(table)
        _say_written([] if picture is None else [picture])
    for message in told:
        _say("yellow", "warning", message)


@app.command(rich_help_panel="Forecast")
def new(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Scenario file (TOML) to write.")],
    geographic: Annotated[
        bool, typer.Option("--geographic/--paper", help="On the real sea, or the paper's case.")
    ] = True,
    release: Annotated[
        tuple[float, float, str] | None,
        typer.Option(
            metavar="LON LAT TIME",
            help="Degrees east, degrees north, UTC; e.g. -4.1 47.2 2026-07-01T06:00",
        ),
    ] = None,
    days: Annotated[float | None, typer.Option(help="Length of the run; default 60.")] = None,
    drifter: Annotated[
        str | None,
        typer.Option("--object", metavar="KEY", help="Search object; see `driftcore objects`."),
    ] = None,
    wind: Annotated[
        str | None, typer.Option(metavar="CSV", help="Wind record: u10, v10 [m/s], UTC.")
    ] = None,
    tides: Annotated[
        str | None, typer.Option(metavar="NC", help="Tidal atlas, `biscay` or `none`.")
    ] = None,
    current: Annotated[str | None, typer.Option(metavar="NC", help="Residual current.")] = None,
    coast: Annotated[str | None, typer.Option(metavar="MAP", help="Land polygons.")] = None,
    overwrite: Overwrite = False,
    defaults: Annotated[
        bool, typer.Option("--defaults", help="Ask nothing; what is left out has its default.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Do not say that the file is written.")
    ] = False,
) -> None:
    """Write a scenario file to start from, with every number explained.

    In a terminal and without options it asks for what matters, and Enter takes what it proposes:
    an example in the Bay of Biscay that runs as it is, which `--defaults` writes without asking.
    """
    from driftcore.files import check_writable, replacing
    from driftcore.geographic_configuration import GeographicConfiguration
    from driftcore.scenario import RunConfiguration

    check_writable(file, overwrite)
    configuration: RunConfiguration | GeographicConfiguration
    nothing = all(v is None for v in (release, days, drifter, wind, tides, current, coast))
    if geographic and nothing and not (defaults or quiet) and _speaks_with_someone():
        configuration = _asked()
    elif geographic:
        configuration = GeographicConfiguration.example(
            release,
            60.0 if days is None else days,
            drifter,
            wind=wind,
            tides=tides,
            current=current,
            coast=coast,
        )
    else:
        given = {"release": release, "days": days, "object": drifter, "wind": wind}
        given |= {"tides": tides, "current": current, "coast": coast}
        for name, value in given.items():
            if value is not None:
                raise ScenarioError(f"--{name}: {value!r} is not accepted with --paper")
        configuration = RunConfiguration()
    with replacing(file, overwrite) as temporary:
        temporary.write_text(configuration.to_toml(), encoding="utf-8")
    if not quiet:
        _say_written([file])


def _speaks_with_someone() -> bool:
    """Say whether somebody can answer: neither pipe nor file stands at either end."""
    return sys.stdin.isatty() and sys.stdout.isatty()


def _asked() -> Any:
    """Ask for what a scenario of the real sea needs; Enter takes what is proposed."""
    from driftcore.geographic_configuration import GeographicConfiguration

    def ask(words: str, default: Any, kind: Any = str) -> Any:
        return typer.prompt(words, default=default, type=kind)

    place = GeographicConfiguration.example().release
    (longitude, latitude) = place.coordinates[0][0] if place else (0.0, 0.0)
    start = f"{place.start:%Y-%m-%dT%H:%M}" if place else ""
    while True:
        release = (
            ask("Longitude of the release [degrees, east positive]", longitude, float),
            ask("Latitude [degrees, north positive]", latitude, float),
            ask("Time [UTC]", start),
        )
        days = ask("Days to follow it", 60.0, float)
        drifter = ask("Search object (`driftcore objects` lists them), or a floating body", "body")
        wind = ask("Wind record (CSV of u10, v10), or embedded: a synthetic climate", "embedded")
        tides = ask("Tides: file of an atlas, biscay: idealised, or none", "biscay")
        coast = ask("Coast: file of land polygons, or natural-earth: of the package", _LAND)
        try:
            return GeographicConfiguration.example(
                release,
                days,
                None if drifter == "body" else drifter,
                wind=None if wind == "embedded" else wind,
                tides=tides,
                coast=None if coast == _LAND else coast,
            )
        except DriftCoreError as error:
            _say("red", "error", " ".join(str(error).split()))


@app.command(rich_help_panel="Forecast")
def objects(
    word: Annotated[
        str, typer.Argument(metavar="[WORD]", help="Those alone that hold this word.")
    ] = "",
    as_json: AsJson = False,
) -> None:
    """List the search objects whose leeway is known."""
    from driftcore.objects import categories

    found = [
        {"key": str(key), "what": row["description"], "downwind": row["downwind_slope_percent"]}
        for key, row in categories().iterrows()
        if word.casefold() in f"{key} {row['description']}".casefold()
    ]
    if not found:
        raise ScenarioError(f"word: {word!r} is in no category; driftcore objects lists them all")
    if as_json:
        _print_json(found)
        return
    table = Table("key", "what", "downwind")
    for one in found:
        table.add_row(one["key"], escape(one["what"]), f"{one['downwind']} %")
    out.print(table)


@app.command(rich_help_panel="Results")
def info(forecast: ForecastFile, as_json: AsJson = False) -> None:
    """Say what is in a forecast file: what was run, and what came of it."""
    from driftcore.results import open_forecast

    opened = open_forecast(forecast)
    if as_json:
        about = {**_result(opened), "attributes": _attributes(opened)}
        sys.stdout.write(json.dumps(about) + "\n")
        return
    _summary(opened, [*set_up(opened), ("written", opened.dataset.attrs["history"])])


@app.command(rich_help_panel="Results")
def plot(
    forecast: ForecastFile,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder for the figures; default that of the file."),
    ] = None,
    coast: Coast = None,
    overwrite: Overwrite = False,
    quiet: Silent = False,
    as_json: AsJson = False,
) -> None:
    """Draw the figures of a forecast.

    Of the paper's case: trajectories, roses, stranding times. On the real sea: paths, arrival,
    stranding rose, and by stretch where the scenario divides its coast. Of both: how the estimate
    settles, and a map of each map time.
    """
    from driftcore import plot
    from driftcore.dataset import is_geographic
    from driftcore.files import filling
    from driftcore.results import open_forecast

    opened = open_forecast(forecast)
    dataset = opened.dataset
    target = forecast.parent if output is None else output
    with filling(target, overwrite) as folder:
        if is_geographic(dataset):
            from driftcore import plot_map

            written = plot_map.save_all(dataset, folder, _land(opened, coast))
        else:
            written = plot.save_all(dataset, folder)
    _list_written([target / path.name for path in written], quiet, as_json)


@app.command(rich_help_panel="Results")
def animate(
    forecast: ForecastFile,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="Film to write: .mp4 or .gif.")
    ],
    coast: Coast = None,
    kind: Annotated[
        str | None,
        typer.Option(metavar="KIND", help="`maps` or `members`; default maps where there are any."),
    ] = None,
    fps: Annotated[float, typer.Option(help="Frames a second.")] = 10.0,
    frames: Annotated[int, typer.Option(min=1, help="At most so many frames.")] = 200,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Write a film of a forecast: its maps, or its kept members, time after time.

    mp4 needs ffmpeg, the system's or that of `pip install "driftcore[animation]"`.
    """
    from driftcore import animation
    from driftcore.dataset import is_geographic
    from driftcore.results import open_forecast

    opened = open_forecast(forecast)
    dataset = opened.dataset
    land = _land(opened, coast) if is_geographic(dataset) else None
    with _bar("frames", quiet or as_json) as progress:
        chosen: Any = kind  # anything else is refused by its name
        animation.save(dataset, output, land, chosen, frames, fps, overwrite, progress)
    _list_written([output], quiet, as_json)


@app.command(rich_help_panel="Results")
def export(
    forecast: ForecastFile,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="File to write: .geojson, .gpkg, .csv, .parquet or .nc.",
        ),
    ],
    written_as: Annotated[
        str | None,
        typer.Option("--format", metavar="NAME", help="Of .nc: `opendrift` or `clouddrift`."),
    ] = None,
    overwrite: Overwrite = False,
    quiet: Silent = False,
    as_json: AsJson = False,
) -> None:
    """Write a forecast for another program, by the end of the file's name.

    `.csv`, `.parquet`: a row for each member. `.geojson`: strandings as points. `.gpkg`:
    strandings, trajectories and cells of the maps, a layer each. `.nc`: trajectories.
    """
    from driftcore.export import export as write_export
    from driftcore.results import open_forecast

    chosen: Any = written_as  # anything else is refused by its name
    write_export(open_forecast(forecast), output, chosen, overwrite)
    _list_written([output], quiet, as_json)


@app.command(rich_help_panel="Results")
def report(
    forecast: ForecastFile,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="HTML file to write; default beside the forecast."),
    ] = None,
    coast: Coast = None,
    overwrite: Overwrite = False,
    quiet: Silent = False,
    as_json: AsJson = False,
) -> None:
    """Write a forecast as one page for whoever must decide: map, coast, arrival, limits.

    It opens in any browser, asks for no network, and prints.
    """
    from driftcore import report as page
    from driftcore.coast import LandCoast
    from driftcore.results import open_forecast

    target = forecast.with_suffix(".html") if output is None else output
    land = None if coast is None else LandCoast.from_file(coast)
    page.write(open_forecast(forecast), target, land, overwrite)
    _list_written([target], quiet, as_json)


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
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Print nothing: the exit code tells.")
    ] = False,
    as_json: AsJson = False,
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
    if as_json:
        checks = [{**asdict(check), "passed": check.passed} for check in measured.checks]
        _print_json({"passed": measured.passed, "checks": checks})
    elif not quiet:
        out.print(table)
        _say_written([] if output is None else [output / REPORT])
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


def _run(
    configuration: Any, folder: Path, threads: int | None, quiet: bool, **store: Any
) -> Forecast:
    from driftcore.runs import run as run_configuration

    with _bar("members", quiet, "fitting the wind") as progress:
        return run_configuration(
            configuration, folder=folder, threads=threads, progress=progress, **store
        )


@contextmanager
def _bar(things: str, quiet: bool, first: str = "beginning") -> Iterator[Any]:
    """Give what shows how far a work is, at which rate, and how long it still takes."""
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(things),
        _Rate(),
        TimeRemainingColumn(),
        console=err,
        disable=quiet or not err.is_terminal,
        transient=True,
    )
    with bar:
        task = bar.add_task(first, total=None)

        def progress(done: int, total: int) -> None:
            described = "following" if things == "members" else "drawing"
            bar.update(task, description=described, completed=done, total=total)

        yield progress


class _Rate(ProgressColumn):
    """Things done in a second."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:.0f}/s" if task.speed and task.total else "")


def _attributes(forecast: Forecast) -> dict[str, Any]:
    """Attributes of a forecast as JSON takes them, without its TOML."""
    return {
        name: value.tolist() if hasattr(value, "tolist") else value
        for name, value in forecast.dataset.attrs.items()
        if name != "configuration"
    }


def _coast(forecast: Any) -> LandCoast | None:
    """Coast of a run on the real sea, with its stretches."""
    try:
        coast: LandCoast | None = forecast.coast()
    except DriftCoreError as error:
        # The forecast outlives the files it was made from.
        _say("yellow", "warning", f"no stretches of the coast: {error}")
        return None
    return coast


def _land(forecast: Any, file: Path | None) -> LandCoast:
    """Land to draw: that of a file, else that of the scenario, else that of the package."""
    from driftcore.coast import LandCoast

    land = _coast(forecast) if file is None else LandCoast.from_file(file)
    return LandCoast.default() if land is None else land


def _stretches(forecast: Forecast) -> list[dict[str, Any]]:
    """Probabilities by stretch of the coast, the greatest first, where it is divided."""
    from driftcore.geographic_forecast import GeographicForecast

    if not isinstance(forecast, GeographicForecast) or not forecast.followed:
        return []
    coast = _coast(forecast)
    if coast is None or not coast.stretches:
        return []
    found = forecast.stranding_by_stretch(coast)
    told = []
    for name, p, low, high in zip(
        *(found[key].values.tolist() for key in ("stretch", "probability", "low", "high")),
        strict=True,
    ):
        if p:
            shape = coast.stretches.get(name)
            middle = None if shape is None else [shape.centroid.x, shape.centroid.y]
            told.append(
                {"stretch": name, "probability": p, "low": low, "high": high, "middle": middle}
            )
    return sorted(told, key=lambda stretch: -stretch["probability"])


def _or_none(value: float) -> float | None:
    """JSON knows no NaN."""
    return None if math.isnan(value) else value


def _result(forecast: Forecast) -> dict[str, Any]:
    # Without a member that could be followed there is no probability.
    p = forecast.stranding_probability() if forecast.followed else None
    quantiles = forecast.stranding_time_quantiles()
    attributes = forecast.dataset.attrs
    targets = forecast.dataset["target"].values if "target" in forecast.dataset else ()
    entries = {str(name): forecast.entry_probability(name) for name in targets if p}
    return {
        "stranding_probability": p and p.estimate,
        "low": p and p.low,
        "high": p and p.high,
        "level": p and p.level,
        **forecast.counts,
        "stranding_time_quantiles": {
            str(t["quantile"].item()): _or_none(t.item()) for t in quantiles
        },
        "stranding_time_intervals": {
            str(t["quantile"].item()): [_or_none(t[bound].item()) for bound in ("low", "high")]
            for t in quantiles
        },
        "days_per_unit_of_time": forecast.days_per_unit,
        "stretches": _stretches(forecast),
        "targets": {
            name: {"probability": e.estimate, "low": e.low, "high": e.high}
            for name, e in entries.items()
        },
        "model": attributes["model"],
        "seed": int(attributes["seed"]),
        "wind": attributes["wind_label"],
    }


def _rows(rows: Iterable[tuple[str, str]] = ()) -> Table:
    """Table of what and its value, without lines."""
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    for name, text in rows:
        table.add_row(name, escape(text))
    return table


def _duration(seconds: float) -> str:
    for unit, length in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.1f} {unit}"
    return f"{seconds:.1f} s"


def _summary(forecast: Forecast, about: Iterable[tuple[str, str]] = ()) -> None:
    result = _result(forecast)
    attributes = forecast.dataset.attrs
    unit = result["days_per_unit_of_time"]
    days = attributes["days"] if "days" in attributes else attributes["duration"] * unit
    run = ("run", f"{attributes['members']} members, {days:.1f} days")
    table = _rows([*about, *how(forecast), run])
    if forecast.followed:
        table.add_row(
            "strands",
            f"[bold]{result['stranding_probability']:.3f}[/]  "
            f"({result['level'] * 100:.0f} % interval {result['low']:.3f} to {result['high']:.3f})",
        )
    early, middle, late = result["stranding_time_quantiles"].values()
    if middle is not None:
        low, high = result["stranding_time_intervals"]["0.5"]
        between = "" if None in (low, high) else f" ({low * unit:.1f} to {high * unit:.1f})"
        table.add_row(
            "when",
            f"median {middle * unit:.1f} days{between}; nine in ten between "
            f"{early * unit:.1f} and {late * unit:.1f}",
        )
        found = forecast.stranding_by_sector(8)
        names = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
        shares = (found[key].values for key in ("probability", "low", "high"))
        ranked = sorted(zip(*shares, names, strict=True), reverse=True)[:3]
        table.add_row(
            "where",
            ", ".join(
                f"{name} {share:.3f} ({low:.3f} to {high:.3f})"
                for share, low, high, name in ranked
                if share
            ),
        )
    for k, stretch in enumerate(result["stretches"][:_STRETCHES]):
        table.add_row(
            "" if k else "stretches",
            f"{stretch['probability']:.3f}  ({stretch['low']:.3f} to {stretch['high']:.3f})  "
            + escape(_named(stretch)),
        )
    for k, (name, entry) in enumerate(result["targets"].items()):
        table.add_row(
            "" if k else "enters",
            f"{entry['probability']:.3f}  ({entry['low']:.3f} to {entry['high']:.3f})  "
            + escape(name),
        )
    for name in ("left_domain", "failed"):
        if result[name]:
            table.add_row(name.replace("_", " "), f"{result[name]} members")
    out.print(table)


def _named(stretch: dict[str, Any]) -> str:
    """Name of a stretch, and its middle."""
    if stretch["middle"] is None:
        return str(stretch["stretch"])
    longitude, latitude = stretch["middle"]
    return f"{stretch['stretch']}, about {place_name(longitude, latitude)}"


def _print_json(told: Any) -> None:
    sys.stdout.write(json.dumps(told) + "\n")


def _list_written(paths: list[Path], quiet: bool, as_json: bool) -> None:
    if as_json:
        _print_json({"files": [str(path) for path in paths]})
    elif not quiet:
        _say_written(paths)


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
    """Entry point: exit code 2 and one line for what the user can mend.

    130 when interrupted, 143 when asked to end (SIGTERM), which tidies up all the same.
    """
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, _terminate)
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
