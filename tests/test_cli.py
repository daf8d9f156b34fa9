"""The command line as a user meets it: results, refusals of one line, nothing left behind."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pytest
import typer
import xarray as xr

import driftcore as dc
from driftcore import cli, files
from driftcore.climate import synthetic_record
from driftcore.errors import OutputError

SMALL = "[ensemble]\nmembers = 3\n[wind]\nh = 0.3\n"
OF_FILE = SMALL + 'record = "wind.csv"\n'
RECORD = synthetic_record(3)
FIGURES = {"trajectories.png", "roses.png", "stranding_times.png", "estimate.png"}


class Result(NamedTuple):
    """What a command left: its exit code and what it printed."""

    code: int
    out: str
    err: str


Command = Callable[..., Result]


@pytest.fixture
def driftcore(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Command:
    """Run the command in an empty folder, on a synthetic climate of few summers: fitted at once."""
    monkeypatch.setattr("driftcore.climate.synthetic_record", lambda: RECORD)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")

    def call(*arguments: object) -> Result:
        monkeypatch.setattr(sys, "argv", ["driftcore", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        out, err = capsys.readouterr()
        assert isinstance(end.value.code, int)
        return Result(end.value.code, out, err)

    return call


@contextmanager
def unchanged(folder: Path = Path()) -> Iterator[None]:
    """Check that no file or folder, hidden or not, comes or goes."""
    before = sorted(folder.rglob("*"))
    yield
    assert sorted(folder.rglob("*")) == before


def refused(result: Result, *words: str) -> None:
    """Check for exit code 2 and one line that holds the words."""
    assert result.code == 2, result
    assert result.out == ""
    assert result.err.startswith("error: ")
    assert result.err.count("\n") == 1
    for word in words:
        assert word in result.err


def write(text: str, path: str = "scenario.toml") -> Path:
    Path(path).write_text(text, encoding="utf-8")
    return Path(path)


def names(folder: str | Path = ".") -> set[str]:
    return {path.name for path in Path(folder).iterdir()}


# Results


def test_run_prints_a_summary_and_writes_the_forecast(driftcore: Command) -> None:
    result = driftcore("run", write(SMALL), "-o", "out.nc")
    assert result.code == 0
    assert result.err == ""
    words = ("synthetic", "mean-flow, order 1, seed 1", "3 members, 26.0 days", "95 % interval")
    assert all(word in result.out for word in words)
    assert result.out.endswith("wrote out.nc\n")
    assert dc.open_forecast("out.nc").dataset.sizes["member"] == 3


def test_json_holds_what_the_forecast_says(driftcore: Command) -> None:
    some_strand = SMALL.replace("members = 3", "members = 20")
    result = driftcore("run", write(some_strand), "-o", "out.nc", "--json")
    told = json.loads(result.out)
    forecast = dc.open_forecast("out.nc")
    p = forecast.stranding_probability()
    assert (result.code, result.err) == (0, "")
    assert (told["stranding_probability"], told["low"], told["high"]) == (p.estimate, p.low, p.high)
    assert {name: told[name] for name in forecast.counts} == forecast.counts
    quantiles = forecast.stranding_time_quantiles((0.05, 0.5, 0.95))
    assert list(told["stranding_time_quantiles"].values()) == pytest.approx(quantiles.values)
    assert list(told["stranding_time_intervals"]) == ["0.05", "0.5", "0.95"]
    assert told["stranding_time_intervals"]["0.5"] == [quantiles[1].low, quantiles[1].high]
    # Of twenty the first in twenty has no lower bound.
    assert told["stranding_time_intervals"]["0.05"][0] is None


def test_as_many_members_as_precision_takes(driftcore: Command) -> None:
    scenario = SMALL.replace("members = 3", 'members = "auto"\nprecision = 0.028')
    told = json.loads(driftcore("check", write(scenario), "--json").out)
    result = json.loads(driftcore("run", write(scenario), "-o", "out.nc", "--json").out)
    forecast = dc.open_forecast("out.nc")
    assert forecast.stranding_probability().half_width <= 0.028
    assert 1000 <= told["estimate"]["members"] <= 2000
    again = dc.run(dc.RunConfiguration.from_toml(forecast.configuration()))
    assert again.dataset.equals(forecast.dataset)
    assert result["high"] - result["low"] <= 0.056


def test_what_is_entered_is_in_the_summary(driftcore: Command) -> None:
    square = "[targets]\nhere = [[0.9, 0.9], [1.1, 0.9], [1.1, 1.1], [0.9, 1.1]]\n"
    result = driftcore("run", write(SMALL + square), "-o", "out.nc")
    # From where it is released; of three, 0.439 is Wilson's lower bound.
    assert re.search(r"enters +1\.000  \(0\.439 to 1\.000\)  here", result.out)


def test_words_of_the_summary() -> None:
    assert [cli._duration(s) for s in (0.04, 119.94, 121, 7199, 7201)] == [
        "0.0 s", "119.9 s", "2.0 min", "120.0 min", "2.0 h",
    ]  # fmt: skip
    assert cli._named({"stretch": "west", "middle": None}) == "west"
    named = cli._named({"stretch": "west", "middle": (-4.25, 47.5)})
    assert named == "west, about 47.5000 N 4.2500 W"
    rate: Any = cli._Rate()
    for speed, total, told in ((None, 10, ""), (12.4, None, ""), (12.4, 10, "12/s")):
        assert rate.render(SimpleNamespace(speed=speed, total=total)).plain == told


def test_warnings_of_others_are_left_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with cli._spoken_warnings():
            warnings.warn("of ours", dc.DriftCoreWarning, stacklevel=1)
            warnings.warn("of others", UserWarning, stacklevel=1)
    assert [str(warning.message) for warning in caught] == ["of others"]
    assert capsys.readouterr().err == "warning: of ours\n"


def test_quiet_prints_nothing(driftcore: Command) -> None:
    scenario = write(SMALL)
    assert driftcore("run", scenario, "-o", "out.nc", "--quiet") == (0, "", "")
    assert driftcore("plot", "out.nc", "-o", "figures", "-q") == (0, "", "")


def test_plot_writes_its_figures_beside_the_file_or_where_told(driftcore: Command) -> None:
    driftcore("run", write(SMALL), "-o", "out.nc")
    assert driftcore("plot", "out.nc").code == 0
    # Brackets are markup to the printer and characters to the file system.
    result = driftcore("plot", "out.nc", "-o", "new/[b]figures")
    assert result.out.count("wrote new/[b]figures/") == len(FIGURES)
    assert names("new/[b]figures") == FIGURES
    assert names() == {"scenario.toml", "out.nc", "new", *FIGURES}


def test_demo_can_be_run_again_from_its_scenario_and_from_its_file(driftcore: Command) -> None:
    """Both give bitwise the same values."""
    assert driftcore("demo", "--members", 4, "-o", "a/demo", "-q") == (0, "", "")
    assert names("a/demo") > {"demo.nc", *FIGURES}
    assert names("a") == {"demo"}
    demo = dc.open_forecast("a/demo/demo.nc")

    printed = driftcore("demo", "--members", 4, "--print-scenario")
    assert printed.code == 0
    for name, text in {"printed": printed.out, "recorded": demo.configuration()}.items():
        driftcore("run", write(text, f"{name}.toml"), "-o", f"{name}.nc", "-q")
        assert dc.open_forecast(f"{name}.nc").dataset.equals(demo.dataset)


def test_run_with_a_record_can_be_run_again_from_anywhere(
    driftcore: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("here").mkdir()
    RECORD.to_csv("here/wind.csv")
    driftcore("run", write(OF_FILE, "here/a.toml"), "-o", "a.nc")
    first = dc.open_forecast("a.nc")
    Path("there").mkdir()
    monkeypatch.chdir("there")
    driftcore("run", write(first.configuration()), "-o", "b.nc")
    assert dc.open_forecast("b.nc").dataset.equals(first.dataset)


def test_forecast_of_failed_members_is_told(driftcore: Command) -> None:
    scenario = write(SMALL + "[scenario]\nvelocity = [1e300, 0]\n")
    result = driftcore("run", scenario, "-o", "out.nc")
    assert result.code == 0
    assert result.err.startswith("warning: 3 of 3 members failed")
    assert "failed  3 members" in result.out
    told = json.loads(driftcore("run", scenario, "-o", "out2.nc", "--json").out)
    assert told["stranding_probability"] is None
    refused(driftcore("plot", "out.nc", "-o", "figures"), "none of 3 members could be followed")
    assert not Path("figures").exists()


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ([], ["demo", "new", "check", "run", "objects", "info", "plot", "animate", "export"]),
        (["demo"], ["--members", "--seed", "--print-scenario", "--output"]),
        (["run"], ["SCENARIO", "--output", "--json", "--quiet", "--overwrite", "--threads"]),
        (["new"], ["FILE", "--release", "LON LAT TIME", "--paper", "--object", "--wind"]),
        (["check"], ["SCENARIO", "--threads", "--json"]),
        (["objects"], ["WORD"]),
        (["info"], ["FORECAST", "--json"]),
        (["animate"], ["FORECAST", "--output", "--fps", "--frames", "--coast", "ffmpeg"]),
        (["export"], ["FORECAST", "--output", "--format", ".gpkg", "opendrift"]),
        (["plot"], ["FORECAST", "--output"]),
        (["validate"], ["--output", "--record", "--months", "Exit code 1"]),
    ],
)
def test_help_fits_eighty_columns(driftcore: Command, command: list[str], words: list[str]) -> None:
    result = driftcore(*command, "--help")
    assert (result.code, result.err) == (0, "")
    assert max(map(len, result.out.splitlines())) <= 80
    assert f"Usage: {' '.join(['driftcore', *command])}" in result.out
    assert all(word in result.out for word in words)


def test_the_reference_holds_every_command_and_option() -> None:
    page = (Path(__file__).parents[1] / "docs/api/cli.md").read_text(encoding="utf-8")
    told = dict(re.findall(r"^\| `([a-z]+)[^|]*\|(.*)\|$", page, re.MULTILINE))
    commands = typer.main.get_command(cli.app).commands  # type: ignore[attr-defined]
    assert set(told) == set(commands)
    everywhere = {"--help", "--quiet", "--json", "--overwrite", "--threads", "--output", "--coast"}
    for name, command in commands.items():
        for option in {o for p in command.params for o in p.opts if o.startswith("--")}:
            assert f"`{option}" in (page if option in everywhere else told[name]), (name, option)


def test_version(driftcore: Command) -> None:
    assert driftcore("--version") == (0, f"driftcore {dc.__version__}\n", "")


# The real sea

LAND = (
    '{"type": "Polygon", "coordinates": [[[-3.9, 46], [-3, 46], [-3, 48], [-3.9, 48], [-3.9, 46]]]}'
)
NEW = [
    *("new", "my.toml", "--release", "-4.1", "47.2", "2026-07-01T06:00", "--days", "20"),
    *("--object", "CONTAINER-2", "--tides", "biscay", "--wind", "wind.csv", "--coast", "land.json"),
]


def own_case(driftcore: Command) -> Path:
    """Scenario of a container off a coast of one's own, of few members."""
    RECORD.to_csv("wind.csv")
    write(LAND, "land.json")
    assert driftcore(*NEW) == (0, "wrote my.toml\n", "")
    text = Path("my.toml").read_text(encoding="utf-8").replace("members = 1000", "members = 60")
    divided = text.replace("# divide_km =", "divide_km = 50").replace("# h =", "h = 0.3")
    return write(divided, "my.toml")


def test_own_case_from_an_empty_folder(driftcore: Command) -> None:
    scenario = own_case(driftcore)
    with unchanged():
        checked = driftcore("check", scenario)
    assert checked.code == 0
    words = ("47.2000 N 4.1000 W", "leeway of CONTAINER-2", "M2 0.24 m/s", "land.json: 1 polygons")
    assert all(word in checked.out for word in (*words, "epsilon 0.026", "cost", "60 members"))
    assert max(map(len, checked.out.splitlines())) <= 80
    assert checked.err.count("\n") == 1
    assert checked.err.startswith("warning: tides: the idealised ones")

    run = driftcore("run", scenario, "-o", "out.nc")
    assert (run.code, run.err) == (0, "")
    assert all(word in run.out for word in ("strands", "stretches", "coast 10, about", "20.0 days"))
    assert run.out.endswith("wrote out.nc\n")
    assert names() == {"wind.csv", "land.json", "my.toml", "out.nc"}
    told = json.loads(driftcore("run", scenario, "-o", "again.nc", "--json").out)
    assert sum(told[status] for status in ("afloat", "stranded", "left_domain", "failed")) == 60
    assert told["stranded"] > 0
    assert told["days_per_unit_of_time"] == 1
    shares = [stretch["probability"] for stretch in told["stretches"]]
    assert shares == sorted(shares, reverse=True)
    assert sum(shares) == pytest.approx(told["stranding_probability"])


def test_a_forecast_outlives_its_coast(
    driftcore: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    forecast = dc.run(dc.GeographicConfiguration.from_toml(own_case(driftcore)))
    assert len(cli._result(forecast)["stretches"]) > 1
    Path("land.json").unlink()
    assert cli._result(forecast)["stretches"] == []
    assert "warning: no stretches of the coast: coast.file:" in capsys.readouterr().err
    forecast.to_netcdf("out.nc")
    film = driftcore("animate", "out.nc", "-o", "film.gif", "--frames", 2)
    assert (film.code, film.out) == (0, "wrote film.gif\n")
    assert "coast.file:" in film.err  # it draws the scenario's where it can


def test_check_estimates_the_cost(driftcore: Command) -> None:
    scenario = own_case(driftcore)
    few = json.loads(driftcore("check", scenario, "--json", "--threads", 1).out)
    assert few["warnings"] == [
        "tides: the idealised ones of the Bay of Biscay are there to try, no atlas"
    ]
    assert few["attributes"]["scaling_tide"] == pytest.approx(0.376, abs=1e-3)
    assert few["estimate"]["threads"] == 1
    many = scenario.read_text(encoding="utf-8").replace("members = 60", "members = 60000000")
    estimate = json.loads(driftcore("check", write(many), "--json").out)["estimate"]
    # Of each member: its status, two positions and two times.
    assert estimate["megabytes"] == pytest.approx(60 * 57, rel=0.2)
    following = [of["seconds"] - of["preparation_s"] for of in (few["estimate"], estimate)]
    assert following[1] > 1000 * following[0]
    assert following[1] == pytest.approx(60_000_000 / estimate["members_per_second"])


def test_check_of_the_paper_and_of_a_wind_out_of_season(driftcore: Command) -> None:
    paper = driftcore("check", write(SMALL))
    assert (paper.code, paper.err) == (0, "")
    assert all(word in paper.out for word in ("epsilon 0.02", "3 members", "seed 1"))
    assert driftcore("check", "scenario.toml", "--quiet") == (0, "", "")
    driftcore("new", "my.toml", "--release", "-4.1", "47.2", "2026-11-01", "--tides", "biscay")
    told = driftcore("check", "my.toml").err.splitlines()
    assert all(line.startswith("warning: ") for line in told)
    assert "the run starts in month 11" in told[0]
    assert "synthetic climate" in told[1]


def test_new_without_options_runs_as_it_is(driftcore: Command) -> None:
    driftcore("new", "my.toml")
    text = Path("my.toml").read_text(encoding="utf-8")
    write(text.replace("days = 60.0", "days = 10").replace("members = 1000", "members = 2"))
    assert driftcore("run", "scenario.toml", "-o", "out.nc", "--quiet").code == 0
    driftcore("new", "paper.toml", "--paper")
    assert Path("paper.toml").read_text(encoding="utf-8") == dc.RunConfiguration().to_toml()
    with unchanged():
        refused(driftcore("new", "my.toml"), "my.toml: exists", "--overwrite")
        refused(driftcore("new", "b.toml", "--paper", "--wind", "w.csv"), "--wind: 'w.csv'")
        refused(driftcore("new", "b.toml", "--paper", "--days", "5"), "--days: 5")
        refused(driftcore("new", "b.toml", "--object", "RAFT"), "object.category: 'RAFT'", "mean")
        release = ("--release", "-4.1", "47.2", "noon")
        refused(driftcore("new", "b.toml", *release), "release.start: 'noon' is not accepted")
        refused(driftcore("new", "no/b.toml"), "no/b.toml: folder no does not exist")


def test_objects_lists_what_holds_a_word(driftcore: Command) -> None:
    everything, containers = driftcore("objects"), driftcore("objects", "Container")
    assert everything.code == containers.code == 0
    assert max(map(len, everything.out.splitlines())) <= 80
    assert all(key in everything.out for key in dc.objects.categories().index)
    assert "CONTAINER-2 │ 20-foot container, 80 % under water" in containers.out
    assert "PIW-1" not in containers.out
    refused(driftcore("objects", "unicorn"), "'unicorn' is in no category")


# What is wrong with a scenario of the real sea, put into a file that is right.
WRONG = {
    "no wind": ("wind.csv", "mywind.csv", "wind.record: 'mywind.csv'", "no such file"),
    "no coast": ("land.json", "coast.shp", "coast.file: 'coast.shp'", "no such file"),
    "a typing error in a key": ("days =", "dyas =", "dyas: unknown key", "did you mean 'days'"),
    "no such time": ("2026-07-01T06:00:00", '"1 July"', "release.start: '1 July'", "ISO 8601"),
    "longitude and latitude exchanged": ("[-4.1, 47.2]", "[47.2, -4.1]", "lies outside the data"),
    "on land": ("[-4.1, 47.2]", "[-3.5, 47.2]", "lies on land", "from the sea toward W"),
    "a wind in the place of a tide": ('kind = "biscay"', 'files = "wind.csv"', "[tides]", "NetCDF"),
    "no such model": ('"mean-flow"', '"meanflow"', "ensemble.model: 'meanflow'", "'full'"),
    "months without wind": ("[7]", "[1]", "months: (1,) leaves no row"),
    "not TOML": ("[wind]", "[wind", "my.toml: not valid TOML", "line"),
    "the kind left out": ('kind = "geographic"', "", 'kind: is missing; put kind = "geographic"'),
    "a number as text": ("days = 20.0", 'days = "20"', "days: '20' is not accepted", "number"),
}


@pytest.mark.parametrize("fault", WRONG)
def test_refused_scenarios_of_the_real_sea(driftcore: Command, fault: str) -> None:
    right, wrong, *words = WRONG[fault]
    text = own_case(driftcore).read_text(encoding="utf-8")
    assert right in text
    write(text.replace(right, wrong), "my.toml")
    with unchanged():
        refused(driftcore("run", "my.toml", "-o", "out.nc"), *words)
        refused(driftcore("check", "my.toml"), *words)


@pytest.mark.skipif(sys.platform == "win32", reason="the guide speaks to a Unix shell")
def test_the_guide_runs_from_an_empty_folder(tmp_path: Path) -> None:
    """Its own commands, with few members and a bandwidth that need not be searched."""
    guide = Path(__file__).parents[1] / "docs/guide/first_forecast.md"
    text = guide.read_text(encoding="utf-8")
    faster = "sed -i -e 's/members = 1000/members = 20/' -e 's/^# h =/h = 0.3/' my.toml\n"
    parts = [
        text.split(f"<!-- {name} -->\n```bash\n")[1]
        for name in ("own", "new", "edit", "run", "show")
    ]
    own, new, edit, run, show = (part.split("```\n")[0] for part in parts)
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    subprocess.run(  # noqa: S603 (our own guide)
        ["bash", "-euo", "pipefail", "-c", own + new + edit + faster + run + show],  # noqa: S607
        cwd=tmp_path,
        env={**os.environ, "PATH": path},
        check=True,
        capture_output=True,
    )
    told = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))
    assert told["afloat"] + told["stranded"] == 20
    assert {stretch["stretch"].split()[0] for stretch in told["stretches"]} <= {
        "mainland",
        "island",
    }
    assert 'name_column = "name"' in (tmp_path / "my.toml").read_text(encoding="utf-8")


def test_info_says_what_is_in_a_forecast(driftcore: Command) -> None:
    driftcore("run", write(SMALL), "-o", "paper.nc", "-q")
    shown = driftcore("info", "paper.nc")
    assert (shown.code, shown.err) == (0, "")
    assert all(word in shown.out for word in ("epsilon 0.02", "3 members", "written", "strands"))
    told = json.loads(driftcore("info", "paper.nc", "--json").out)
    assert told["stranded"] + told["afloat"] == 3
    assert told["attributes"]["epsilon"] == 0.02
    refused(driftcore("info", "scenario.toml"), "scenario.toml: cannot be read as NetCDF-4")

    driftcore("run", own_case(driftcore), "-o", "sea.nc", "-q")
    opened = dc.open_forecast("sea.nc")
    shown = driftcore("info", "sea.nc")
    assert (shown.code, shown.err) == (0, "")
    assert all(word in shown.out for word in ("CONTAINER-2", "stretches", "47.2000 N 4.1000 W"))
    told = json.loads(driftcore("info", "sea.nc", "--json").out)
    assert told["stranding_probability"] == opened.stranding_probability().estimate


@pytest.mark.parametrize(
    ("words", "answer"), [("driftcore ani", "animate"), ("driftcore export a.nc --fo", "--format")]
)
def test_a_shell_is_told_how_to_go_on(words: str, answer: str) -> None:
    told = subprocess.run(
        [sys.executable, "-c", "from driftcore.cli import main; main()"],
        env={
            **os.environ,
            "_DRIFTCORE_COMPLETE": "complete_bash",
            "COMP_WORDS": words,
            "COMP_CWORD": str(words.count(" ")),
        },
        capture_output=True,
        text=True,
        check=True,
    )
    assert told.stdout.split() == [answer]


def test_animate_and_export_list_what_they_wrote(driftcore: Command) -> None:
    driftcore("run", write(SMALL), "-o", "out.nc", "-q")
    film = driftcore("animate", "out.nc", "-o", "f.gif", "--frames", 2, "--json")
    assert (film.code, json.loads(film.out), film.err) == (0, {"files": ["f.gif"]}, "")
    assert Path("f.gif").read_bytes()[:4] == b"GIF8"
    assert driftcore("export", "out.nc", "-o", "f.csv") == (0, "wrote f.csv\n", "")
    assert len(pd.read_csv("f.csv")) == 3
    with unchanged():
        refused(driftcore("animate", "out.nc", "-o", "f.gif"), "f.gif: exists", "--overwrite")
        refused(driftcore("animate", "out.nc", "-o", "g.gif", "--kind", "x"), "kind: 'x'")
        refused(driftcore("animate", "out.nc", "-o", "g.avi"), "ends in .gif or .mp4")
        refused(driftcore("export", "out.nc", "-o", "g.gpkg"), "the paper's plane")
        refused(driftcore("export", "out.nc", "-o", "g.nc", "--format", "x"), "format: 'x'")


def test_results_as_json(driftcore: Command) -> None:
    told = json.loads(driftcore("demo", "--members", 4, "-o", "demo", "--json").out)
    assert told["stranded"] + told["afloat"] == 4
    assert {Path(file).name for file in told["files"]} == names("demo")
    told = json.loads(driftcore("plot", "demo/demo.nc", "-o", "f", "--json").out)
    assert {Path(file).name for file in told["files"]} == FIGURES
    found = json.loads(driftcore("objects", "container", "--json").out)
    assert "CONTAINER-2" in {one["key"] for one in found}


def test_check_draws_what_is_set_up(driftcore: Command) -> None:
    scenario = own_case(driftcore)
    assert driftcore("check", scenario, "--plot", "a.png").out.endswith("wrote a.png\n")
    assert driftcore("check", write(SMALL), "--plot", "b.png", "-q").code == 0
    for name in ("a.png", "b.png"):
        assert Path(name).read_bytes()[1:4] == b"PNG"
    with unchanged():
        refused(driftcore("check", scenario, "--plot", "a.png"), "a.png: exists")
        refused(driftcore("check", scenario, "--plot", "a.pdf"), "ends in .png")


def test_plot_draws_the_stretches_of_the_scenario(driftcore: Command) -> None:
    driftcore("run", own_case(driftcore), "-o", "out.nc", "-q")
    assert driftcore("plot", "out.nc", "-o", "f").code == 0
    assert {"stretches.png", "coast.png"} <= names("f")


@pytest.mark.skipif(sys.platform == "win32", reason="it takes a Unix terminal")
def test_new_asks_in_a_terminal_and_nowhere_else(driftcore: Command) -> None:
    import pty

    def in_terminal(answers: str, *arguments: str) -> str:
        ours, theirs = pty.openpty()
        command = [sys.executable, "-c", "from driftcore.cli import main; main()", *arguments]
        process = subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs)  # noqa: S603
        os.close(theirs)
        os.write(ours, answers.encode())
        said = b""
        with suppress(OSError):  # the terminal's end
            while chunk := os.read(ours, 4096):
                said += chunk
        assert process.wait(60) == 0, said
        os.close(ours)
        return said.decode()

    # A wrong object is told, and everything asked again.
    wrong = "-5.5\n\n\n20\nRAFT\n\n\n\n"
    said = in_terminal(wrong + "-5.5\n\n\n20\nPIW-1\n\nnone\n\n", "new", "a.toml")
    assert "Longitude of the release" in said
    assert "object.category: 'RAFT'" in said
    made = dc.GeographicConfiguration.from_toml(Path("a.toml"))
    assert made.release is not None
    assert made.release.coordinates == (((-5.5, 47.2),),)
    assert (made.days, made.tides, made.wind.record) == (20.0, None, "embedded")
    # Enter takes what is proposed: what is written where nobody can be asked.
    assert "[60.0]" in in_terminal(8 * "\n", "new", "b.toml")
    assert "wrote c.toml" in in_terminal("", "new", "c.toml", "--defaults")
    assert driftcore("new", "d.toml") == (0, "wrote d.toml\n", "")
    texts = {Path(f"{name}.toml").read_text(encoding="utf-8") for name in "bcd"}
    assert len(texts) == 1


# Refusals


@pytest.mark.parametrize(
    "arguments",
    [
        ["--bogus"],
        ["bogus"],
        ["run"],
        ["run", "scenario.toml"],
        ["run", "scenario.toml", "-o", "out.nc", "--bogus"],
        ["run", "scenario.toml", "-o", "out.nc", "--threads", "0"],
        ["run", "scenario.toml", "another.toml", "-o", "out.nc"],
        ["demo", "--members", "many"],
        ["demo", "--seed"],
        ["plot"],
        ["info"],
        ["check"],
        ["new"],
        ["new", "my.toml", "--release", "-4.1", "47.2"],
        ["validate", "--bogus"],
    ],
)
def test_usage_errors(driftcore: Command, arguments: list[str]) -> None:
    write(SMALL)
    with unchanged():
        result = driftcore(*arguments)
    assert (result.code, result.out) == (2, "")
    assert "─ Error ─" in result.err


# Scenario files, and what must be in the message. `tests/test_scenario.py` has the rest.
SCENARIOS = {
    "[scenario]\nepsilon = 0": ("scenario.epsilon: 0 is not accepted", "greater than 0"),
    "[ensemble]\nmembers = 0": ("ensemble.members: 0 is not accepted",),
    "[ensemble]\nmembers = -1": ("ensemble.members: -1 is not accepted",),
    "[ensemble]\norder = 3": ("ensemble.order: 3 is not accepted",),
    "[ensemble]\norder = 0": ("ensemble.order: 0", "'mean-flow'", "orders 1 or 2"),
    "[ensemble]\nmodel = 'paper'\nwindow = 0.2": ("window", "windows up to 0.08 (4 tides)"),
    "[ensemble]\nmodel = 'full'\nwindow = 0.01": ("window: model 'full' has none",),
    "[ensemble]\nwindow = 0.01": ("window: model 'mean-flow' has none",),
    "[scenario]\nposition = [5, 5]": ("position: (5, 5) lies outside the coast", "'inside'"),
    "[scenario]\nside = 'outside'": ("position: (1, 1) lies within the coast", "'outside'"),
    "[wind]\nrecrod = 'a'": ("wind.recrod: unknown key", "did you mean 'record'?"),
    "[scenario.coast]\nradus = 1": ("scenario.coast.radus: unknown key", "'radius'?"),
    "[scenario]\nepsilon = 'a'": ("scenario.epsilon: 'a' is not accepted", "valid number"),
    "[scenario]\ndrag = -1\nwind_unit = 0": ("scenario.drag: -1", "; scenario.wind_unit: 0"),
    "[ensemble\n": ("scenario.toml: not valid TOML", "line 1"),
    "[wind]\nmonths = [1]\nh = 0.3": ("months: (1,) leaves no row", "(6, 7, 8)"),
    "[wind]\nb = 0.1": ("b: 0.1 is given, but only mode 'lgb'",),
}


@pytest.mark.parametrize(("toml", "words"), SCENARIOS.items())
def test_refused_scenarios(driftcore: Command, toml: str, words: tuple[str, ...]) -> None:
    scenario = write(toml)
    with unchanged():
        refused(driftcore("run", scenario, "-o", "out.nc"), *words)


def test_scenario_files_that_cannot_be_read(driftcore: Command) -> None:
    Path("latin.toml").write_bytes("name = 'Île'".encode("latin-1"))
    Path("folder").mkdir()
    with unchanged():
        refused(driftcore("run", "no.toml", "-o", "out.nc"), "no.toml: no such file")
        refused(driftcore("run", "latin.toml", "-o", "out.nc"), "latin.toml: is not UTF-8 text")
        refused(driftcore("run", "folder", "-o", "out.nc"), "folder: cannot be read")


def spoilt(name: str) -> pd.DataFrame:
    """A record with one fault."""
    record = RECORD.copy()
    match name:
        case "columns":
            return record.rename(columns={"u10": "speed"})
        case "nan" | "inf":
            record.iloc[5, 0] = float(name)
            return record
        case "gap":
            return record.drop(record.index[10:14])
        case "unsorted":
            return record.iloc[::-1]
        case "repeated":
            return record.iloc[[0, 1, 1, *range(2, len(record))]]
        case "constant":
            return record * 0 + 3
        case "short":
            return record.iloc[:50]
    raise ValueError(name)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("columns", ["'u10' and 'v10'", "'speed'"]),
        ("nan", ["u10: row 5", "nan"]),
        ("inf", ["u10: row 5", "inf"]),
        ("gap", ["gap of 30 h after row 9"]),
        ("unsorted", ["row 1", "is earlier than the row before it"]),
        ("repeated", ["row 2", "repeats the row before it"]),
        ("constant", ["do not vary"]),
        ("short", ["at least 200 are needed"]),
    ],
)
def test_refused_winds(driftcore: Command, fault: str, words: list[str]) -> None:
    spoilt(fault).to_csv("wind.csv")
    scenario = write(OF_FILE)
    with unchanged():
        refused(driftcore("run", scenario, "-o", "out.nc"), *words)


@pytest.mark.parametrize("record", ["no.csv", ".", "empty.csv", "binary.csv", "header.csv"])
def test_winds_that_cannot_be_read(driftcore: Command, record: str) -> None:
    write("", "empty.csv")
    write("time,u10,v10\n", "header.csv")
    Path("binary.csv").write_bytes(bytes(range(256)) * 20)
    scenario = write(f'{SMALL}record = "{record}"\n')
    with unchanged():
        refused(driftcore("run", scenario, "-o", "out.nc"))


def test_knots_are_told_in_one_line_and_taken(driftcore: Command) -> None:
    (RECORD * 3.8).to_csv("wind.csv")
    scenario = write(OF_FILE)
    result = driftcore("run", scenario, "-o", "out.nc")
    assert result.code == 0
    assert result.err.startswith("warning: ")
    assert result.err.count("\n") == 1
    assert "knots" in result.err
    assert Path("out.nc").is_file()


@pytest.mark.parametrize("members", [0, -1])
def test_demo_refuses_members(driftcore: Command, members: int) -> None:
    with unchanged():
        refused(driftcore("demo", f"--members={members}"), f"members: {members} is not accepted")


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no folder that even root cannot write")
def test_folders_that_cannot_be_written(driftcore: Command) -> None:
    scenario = write(SMALL)
    refused(driftcore("run", scenario, "-o", "/proc/out.nc"), "/proc/out.nc: cannot be written")
    refused(driftcore("demo", "--members", 2, "-o", "/proc/a/b"), "/proc/a/b: cannot be written")


def test_outputs_that_cannot_be_written(driftcore: Command) -> None:
    scenario = write(SMALL)
    Path("folder").mkdir()
    name = "n" * 300
    refusals = {
        "no/out.nc": "no/out.nc: folder no does not exist",
        "scenario.toml/out.nc": "scenario.toml/out.nc: folder scenario.toml does not exist",
        "folder": "folder: is a folder; name a file",
        os.devnull: "is a device or a pipe; name a file",
        f"{name}.nc": "cannot be written: File name too long",
    }
    with unchanged():
        refused(driftcore("run", scenario, "-o", "out.csv"), "--output: 'out.csv'", "ends in .nc")
        for output, words in refusals.items():
            refused(driftcore("run", scenario, "-o", output, "--overwrite"), words)
        for output in ("scenario.toml/folder", name):
            result = driftcore("demo", "--members", 2, "-o", output)
            refused(result, f"{output}: cannot be written")


def test_existing_files_are_kept_unless_told(driftcore: Command) -> None:
    scenario = write(SMALL)
    write("precious", "out.nc")
    write("precious", "demo.nc")
    with unchanged():
        refused(driftcore("run", scenario, "-o", "out.nc"), "out.nc: exists", "--overwrite")
        refused(driftcore("demo", "--members", 2, "-o", "."), "demo.nc: exists", "--overwrite")
    assert Path("out.nc").read_text(encoding="utf-8") == "precious"
    assert driftcore("run", scenario, "-o", "out.nc", "--overwrite").code == 0
    write("precious", "roses.png")
    with unchanged():
        refused(driftcore("plot", "out.nc"), "roses.png: exists", "--overwrite")
    assert driftcore("plot", "out.nc", "--overwrite").code == 0
    assert names() > FIGURES


def test_plot_refuses_what_is_no_forecast(driftcore: Command) -> None:
    scenario = write(SMALL)
    driftcore("run", scenario, "-o", "out.nc", "-q")
    content = Path("out.nc").read_bytes()
    Path("truncated.nc").write_bytes(content[:5000])
    damaged = bytearray(content)
    damaged[6000:9000] = np.random.default_rng(1).bytes(3000)
    Path("damaged.nc").write_bytes(damaged)
    xr.Dataset({"status": 1}).to_netcdf("other.nc", engine="h5netcdf")
    with unchanged():
        refused(driftcore("plot", "no.nc", "-o", "p"), "no.nc: cannot be read", "no such file")
        refused(driftcore("plot", ".", "-o", "p"), ".: cannot be read", "is a folder")
        refused(driftcore("plot", scenario, "-o", "p"), "scenario.toml: cannot be read as NetCDF-4")
        refused(driftcore("plot", "truncated.nc", "-o", "p"), "truncated.nc: cannot be read")
        refused(driftcore("plot", "damaged.nc", "-o", "p"), "damaged.nc: cannot be read")
        refused(driftcore("plot", "other.nc", "-o", "p"), "other.nc: is not a driftcore forecast")


def test_out_of_memory_is_told(driftcore: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    def exhausted(*_: Any, **__: Any) -> None:
        raise MemoryError

    # By its module: the package's attribute of this name is the function in it.
    monkeypatch.setattr(sys.modules["driftcore.runs"], "run", exhausted)
    scenario = write(SMALL)
    with unchanged():
        refused(driftcore("run", scenario, "-o", "out.nc"), "out of memory")


# Interruption

ANNOUNCED = """
import sys
from driftcore.cli import main
module = sys.modules["driftcore.runs"]
run = module.run
def announced(*positional, **named):
    print("running", flush=True)
    return run(*positional, **named)
module.run = announced
main()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals are not sent there")
@pytest.mark.parametrize(
    ("sent_signal", "code", "told"),
    [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")],
)
@pytest.mark.parametrize("command", ["run", "demo"])
def test_interruption_leaves_nothing(
    command: str, sent_signal: signal.Signals, code: int, told: str, tmp_path: Path
) -> None:
    long = "[wind]\nh = 0.3\n[ensemble]\nmodel = 'full'\nmembers = 200000\n"
    (tmp_path / "long.toml").write_text(long, encoding="utf-8")
    arguments: dict[str, list[str | Path]] = {
        "run": ["run", tmp_path / "long.toml", "-o", tmp_path / "out.nc"],
        "demo": ["demo", "-o", tmp_path / "new/demo", "--members", "200000"],
    }
    with unchanged(tmp_path):
        with subprocess.Popen(  # noqa: S603 (our own interpreter)
            [sys.executable, "-c", ANNOUNCED, *arguments[command], "--threads", "1"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            # A shell that runs the tests in the background makes them deaf to the signal.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        ) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "running\n"
            time.sleep(0.5)
            sent = time.monotonic()
            process.send_signal(sent_signal)
            out, err = process.communicate(timeout=60)
        # Half a second; more where other work holds the processors.
        assert time.monotonic() - sent < 3
    assert (process.returncode, out, err) == (code, "", f"{told}; nothing was written\n")


def test_letters_that_the_terminal_lacks_stop_nothing(tmp_path: Path) -> None:
    def ascii_only(*arguments: str) -> bytes:
        return subprocess.run(  # noqa: S603 (our own interpreter)
            [sys.executable, "-c", "from driftcore.cli import main; main()", *arguments],
            env={**os.environ, "PYTHONIOENCODING": "ascii"},
            check=True,
            capture_output=True,
        ).stdout

    printed = ascii_only("demo", "--members=1", "--print-scenario").decode("utf-8")
    assert "drag rate Λ" in printed
    scenario, record = tmp_path / "été.toml", tmp_path / "Île.csv"
    RECORD.to_csv(record)
    scenario.write_text(printed.replace("embedded", record.as_posix(), 1), encoding="utf-8")
    assert b"?le.csv" in ascii_only("run", str(scenario), "-o", str(tmp_path / "out.nc"))


# Files


def test_replacing_is_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "result.txt"
    with files.replacing(path, overwrite=False) as temporary:
        temporary.write_text("one", encoding="utf-8")
        assert temporary.suffix == path.suffix
        assert not path.exists()

    def half() -> None:
        with files.replacing(path, overwrite=True) as temporary:
            temporary.write_text("tw", encoding="utf-8")
            raise OSError("half")

    with pytest.raises(OutputError, match="cannot be written: half"):
        half()
    assert names(tmp_path) == {"result.txt"}
    assert path.read_text(encoding="utf-8") == "one"
    umask = os.umask(0)
    os.umask(umask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~umask


def test_filling_moves_everything_or_nothing(tmp_path: Path) -> None:
    target = tmp_path / "new" / "folder"
    with files.filling(target, overwrite=False) as folder:
        (folder / "sub").mkdir()
        (folder / "sub" / "a.txt").write_text("a", encoding="utf-8")
        (folder / "b.txt").write_text("b", encoding="utf-8")
        assert not target.exists()
    assert sorted(path.name for path in tmp_path.rglob("*.txt")) == ["a.txt", "b.txt"]

    def more() -> None:
        with files.filling(target, overwrite=False) as folder:
            (folder / "a.txt").touch()
            (folder / "b.txt").touch()

    with unchanged(tmp_path):
        with pytest.raises(OutputError, match=r"b\.txt: exists"):
            more()
        with pytest.raises(KeyboardInterrupt), files.filling(tmp_path / "x/y", overwrite=False):
            raise KeyboardInterrupt


def test_a_full_disk_is_met_before_the_library_crashes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calm = dc.WindPath([0.0, 1.1], np.zeros((2, 2)))
    forecast = dc.forecast(dc.paper.scenario(), [calm])
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=10))
    with unchanged(tmp_path), pytest.raises(OutputError, match="0 MB are free"):
        forecast.to_netcdf(tmp_path / "out.nc")


def test_the_demo_says_what_it_wrote(driftcore: Command) -> None:
    result = driftcore("demo", "-o", "shown", "--members", "3")
    assert result.code == 0
    for path in Path("shown").iterdir():
        assert str(path) in result.out.replace("\n", "")
    assert {path.name for path in Path("shown").iterdir()} > FIGURES | {"demo.nc"}
