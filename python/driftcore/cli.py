"""The `driftcore` command: parses, calls, saves; holds no science."""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
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
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
ScenarioFile = Annotated[Path, typer.Argument(metavar="SCENARIO", help="Scenario file (TOML).")]
ForecastFile = Annotated[Path, typer.Argument(metavar="FORECAST", help="Forecast file (NetCDF).")]

# Members followed to estimate what all of them cost.
_FEW, _MORE = 32, 256
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
    scenario: ScenarioFile,
    output: Annotated[Path, typer.Option("--output", "-o", help="NetCDF file to write.")],
    threads: Threads = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Run the forecast that a scenario file describes.

    A file to start from, with every number explained: `driftcore new my.toml`. Relative paths in
    it start at its folder.
    """
    from driftcore.files import check_writable
    from driftcore.geographic_configuration import read_configuration

    configuration = read_configuration(scenario)
    check_writable(output, overwrite)
    # The forecast records its wind by this path: absolute, it can be run again from anywhere.
    forecast = _run(configuration, scenario.parent.resolve(), threads, quiet or as_json)
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
) -> None:
    """Check a scenario file, say what it sets up, and estimate what the run costs.

    Everything is read, the wind is fitted, and a few members are followed.
    """
    from driftcore.forecast import default_threads, planned
    from driftcore.geographic_configuration import GeographicConfiguration, read_configuration

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DriftCoreWarning)
        configuration = read_configuration(scenario)
        wanted = configuration.ensemble
        with err.status("reading, fitting the wind, following a few members"):
            start = perf_counter()
            follow = planned(configuration, scenario.parent.resolve())
            times, sizes, numbers = [], [], (min(_FEW, wanted.members), min(_MORE, wanted.members))
            times.append(perf_counter() - start)
            for members in numbers:
                start = perf_counter()
                keep = round(members * min(1, wanted.keep / wanted.members))
                forecast = follow(members=members, keep=keep, threads=threads)
                times.append(perf_counter() - start)
                sizes.append(forecast.dataset.nbytes)
    told = [str(w.message) for w in caught if issubclass(w.category, DriftCoreWarning)]
    if isinstance(configuration, GeographicConfiguration):
        told += configuration.doubts()
    told = list(dict.fromkeys(told))
    reading, few, more = times
    between = max(1, numbers[1] - numbers[0])
    each, size = max(0.0, more - few) / between, (sizes[1] - sizes[0]) / between
    rest = wanted.members - numbers[1]
    seconds = reading + more + each * rest
    megabytes = (sizes[1] + size * rest) / 1e6
    estimate = {
        "members": wanted.members,
        "threads": threads or default_threads(),
        "preparation_s": reading + max(0.0, few - each * numbers[0]),
        "seconds": seconds,
        "members_per_second": 1 / each if each else None,
        "megabytes": megabytes,
    }
    if as_json:
        about = {"attributes": _attributes(forecast), "estimate": estimate, "warnings": told}
        sys.stdout.write(json.dumps(about) + "\n")
        return
    table = _rows([*set_up(forecast), *how(forecast)])
    table.add_row(
        "cost",
        f"{wanted.members} members: about {_duration(seconds)} on "
        f"{estimate['threads']} threads, {max(1, round(megabytes))} MB",
    )
    if not quiet:
        out.print(table)
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
) -> None:
    """Write a scenario file to start from, with every number explained.

    Without options it is an example in the Bay of Biscay that runs as it is.
    """
    from driftcore.files import replacing
    from driftcore.geographic_configuration import GeographicConfiguration
    from driftcore.scenario import RunConfiguration

    configuration: RunConfiguration | GeographicConfiguration
    if geographic:
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
    _say_written([file])


@app.command(rich_help_panel="Forecast")
def objects(
    word: Annotated[
        str, typer.Argument(metavar="[WORD]", help="Those alone that hold this word.")
    ] = "",
) -> None:
    """List the search objects whose leeway is known."""
    from driftcore.objects import categories

    table = Table("key", "what", "downwind")
    for key, row in categories().iterrows():
        if word.casefold() in f"{key} {row['description']}".casefold():
            table.add_row(
                str(key), escape(row["description"]), f"{row['downwind_slope_percent']} %"
            )
    if not table.row_count:
        raise ScenarioError(f"word: {word!r} is in no category; driftcore objects lists them all")
    out.print(table)


@app.command(rich_help_panel="Results")
def info(forecast: ForecastFile, as_json: AsJson = False) -> None:
    """Say what is in a forecast file: what was run, and what came of it."""
    from driftcore.forecast import open_forecast

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
    coast: Annotated[
        Path | None,
        typer.Option(help="Land to draw on the real sea; default that of the package."),
    ] = None,
    overwrite: Overwrite = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Do not list the files written.")
    ] = False,
) -> None:
    """Draw the figures of a forecast.

    Of the paper's case: trajectories, roses, stranding times. On the real sea: paths, arrival,
    and a map of each map time.
    """
    from driftcore import plot
    from driftcore.dataset import is_geographic
    from driftcore.files import filling
    from driftcore.forecast import open_forecast

    dataset = open_forecast(forecast).dataset
    target = forecast.parent if output is None else output
    with filling(target, overwrite) as folder:
        if is_geographic(dataset):
            from driftcore import plot_map
            from driftcore.coast import LandCoast

            land = LandCoast.default() if coast is None else LandCoast.from_file(coast)
            written = plot_map.save_all(dataset, folder, land)
        else:
            written = plot.save_all(dataset, folder)
    if not quiet:
        _say_written([target / path.name for path in written])


@app.command(rich_help_panel="Results")
def report(
    forecast: ForecastFile,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="HTML file to write; default beside the forecast."),
    ] = None,
    coast: Annotated[
        Path | None,
        typer.Option(help="Land to draw on the real sea; default that of the scenario."),
    ] = None,
    overwrite: Overwrite = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Do not name the file written.")
    ] = False,
) -> None:
    """Write a forecast as one page for whoever must decide: map, coast, arrival, limits.

    It opens in any browser, asks for no network, and prints.
    """
    from driftcore import report as page
    from driftcore.coast import LandCoast
    from driftcore.forecast import open_forecast

    target = forecast.with_suffix(".html") if output is None else output
    land = None if coast is None else LandCoast.from_file(coast)
    page.write(open_forecast(forecast), target, land, overwrite)
    if not quiet:
        _say_written([target])


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
        _Rate(),
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


class _Rate(ProgressColumn):
    """Members followed in a second."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:.0f}/s" if task.speed and task.total else "")


def _attributes(forecast: Forecast) -> dict[str, Any]:
    """Attributes of a forecast as JSON takes them, without its TOML."""
    return {
        name: value.tolist() if hasattr(value, "tolist") else value
        for name, value in forecast.dataset.attrs.items()
        if name != "configuration"
    }


def _stretches(forecast: Forecast) -> list[dict[str, Any]]:
    """Probabilities by stretch of the coast, the greatest first, where it is divided."""
    from driftcore.geographic_forecast import GeographicForecast

    if not isinstance(forecast, GeographicForecast) or not forecast.followed:
        return []
    try:
        coast = forecast.coast()
    except DriftCoreError as error:
        # The forecast outlives the files it was made from.
        _say("yellow", "warning", f"no stretches of the coast: {error}")
        return []
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


def _result(forecast: Forecast) -> dict[str, Any]:
    # Without a member that could be followed there is no probability.
    p = forecast.stranding_probability() if forecast.followed else None
    quantiles = forecast.stranding_time_quantiles().values
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
            str(q): None if t != t else float(t)
            for q, t in zip((0.05, 0.5, 0.95), quantiles, strict=True)
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
        table.add_row(
            "when",
            f"median {middle * unit:.1f} days; nine in ten between "
            f"{early * unit:.1f} and {late * unit:.1f}",
        )
        sectors = forecast.stranding_by_sector(8)["probability"].values
        names = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
        ranked = sorted(zip(sectors, names, strict=True), reverse=True)[:3]
        table.add_row("where", ", ".join(f"{name} {share:.3f}" for share, name in ranked if share))
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
