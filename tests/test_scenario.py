"""Configurations: what is accepted, what is told of the rest, and TOML there and back."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

import driftcore as dc
from driftcore.errors import ScenarioError
from driftcore.scenario import (
    EnsembleConfiguration,
    ModelName,
    RunConfiguration,
    Scenario,
    WindConfiguration,
)
from strategies import epsilons, numbers, positions, scenario_numbers, sides, vectors

MODELS: list[tuple[ModelName, int | None]] = [
    ("full", None),
    ("paper", 0),
    ("paper", 1),
    ("mean-flow", None),
    ("mean-flow", 2),
]

positive = numbers(1e-3, 1e3)
# Whatever a file may be called or a user may write; surrogates are no text.
texts = st.text(st.characters(codec="utf-8"), max_size=20)


@st.composite
def coasts(draw: st.DrawFn) -> dc.Circle | dc.Polygons | None:
    rings = st.lists(st.lists(vectors(-9, 9), min_size=3, max_size=6), min_size=1, max_size=3)
    return draw(
        st.none()
        | st.builds(dc.Circle, center=positions, radius=positive)
        | st.builds(dc.Polygons, rings=rings)
    )


@st.composite
def ensembles(draw: st.DrawFn) -> EnsembleConfiguration:
    model, order = draw(st.sampled_from(MODELS))
    return EnsembleConfiguration(
        members=draw(st.integers(1, 10**8)),
        seed=draw(st.integers(0, 2**64 - 1)),
        model=model,
        order=order,
        window=draw(st.none() | positive),
        wind_terms=draw(st.booleans()),
        rtol=draw(numbers(1e-15, 0.09)),
        keep=draw(st.integers(0, 1000)),
        outputs_per_tide=draw(numbers(0.1, 100)),
    )


runs = st.builds(
    RunConfiguration,
    scenario=st.builds(
        Scenario,
        name=texts,
        epsilon=epsilons,
        duration=numbers(0.01, 2.0),
        drag=positive,
        position=positions,
        velocity=vectors(-1, 1),
        wind_unit=positive,
        tide_period_h=numbers(1, 30),
        side=sides,
        coast=coasts(),
    ),
    wind=st.builds(
        WindConfiguration,
        record=texts,
        months=st.lists(st.integers(1, 12), min_size=1, max_size=12),
        gaps=st.sampled_from(["error", "segment"]),
        mode=st.sampled_from(["residual", "lgb"]),
        order=st.integers(1, 8),
        h=st.none() | positive,
        b=st.none() | numbers(0, 1),
        share=numbers(0, 0.99),
        memory_h=positive,
    ),
    ensemble=ensembles(),
)


# TOML


@given(run=runs)
def test_toml_gives_the_same_configuration_back(run: RunConfiguration) -> None:
    assert RunConfiguration.from_toml(run.to_toml()) == run


def test_toml_explains_every_number() -> None:
    text = RunConfiguration().to_toml()
    assert text.startswith("[scenario]\n")
    values = [line for line in text.splitlines() if "=" in line]
    assert len(values) > 30
    assert [line for line in values if "# " not in line] == ['kind = "academic"', 'kind = "circle"']


def test_toml_default_is_empty_file() -> None:
    assert RunConfiguration.from_toml("") == RunConfiguration()


def test_toml_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "windows.toml"
    path.write_bytes(b"\xef\xbb\xbf[ensemble]\r\nmembers = 7\r\n")
    assert RunConfiguration.from_toml(path).ensemble.members == 7


def test_toml_switches_the_coast_off() -> None:
    nowhere = dc.paper.scenario(coast=None)
    assert tomllib.loads(nowhere.to_toml())["coast"] == "none"
    assert Scenario.from_toml(nowhere.to_toml()).coast is None


def test_coast_without_kind_is_the_circle() -> None:
    assert Scenario.from_toml("coast = {radius = 0.5}").coast == dc.Circle(radius=0.5)


def test_sea_from_python_is_named_in_toml_but_refused_from_it() -> None:
    axis = np.arange(4.0)
    field = xr.DataArray(
        np.zeros((1, 2, 4, 4), complex),
        {"harmonic": [1], "component": ["x", "y"], "y": axis, "x": axis},
    )
    text = Scenario(sea=dc.HarmonicSea(field)).to_toml()
    with pytest.raises(ScenarioError, match=r"sea: 'HarmonicSea\(.*a sea given in Python"):
        Scenario.from_toml(text)


# Refusals: what the message must hold, the path of the field first.
REFUSED = {
    "[scenario]\nepsilon = 0": "scenario.epsilon: 0 is not accepted; it should be greater than 0",
    "[scenario]\nepsilon = -0.1": "scenario.epsilon: -0.1 is not accepted",
    "[scenario]\nepsilon = 1": "scenario.epsilon: 1 is not accepted",
    "[scenario]\nepsilon = nan": "scenario.epsilon: nan is not accepted",
    "[scenario]\nduration = inf": "scenario.duration: inf is not accepted",
    "[scenario]\nepsilon = 1e-300": "scenario.epsilon: 1e-300 is not accepted; with duration = 1.0",
    "[scenario]\ntide_period_h = 1e9": "would last 50 tides, 2.08e+09 days; at most",
    "[scenario]\nside = 'left'": "side: 'left' is not accepted; it should be 'inside' or 'outside'",
    "[ensemble]\nmembers = 0": "ensemble.members: 0 is not accepted",
    "[ensemble]\nmembers = -1": "ensemble.members: -1 is not accepted",
    "[ensemble]\nmembers = 100000000000": "ensemble.members: 100000000000 is not accepted",
    "[ensemble]\norder = 3": "ensemble.order: 3 is not accepted",
    "[ensemble]\norder = 0": "ensemble.order: 0 is not accepted for model 'mean-flow'",
    "[ensemble]\nmodel = 'full'\norder = 1": "ensemble.order: 1 is not accepted for model 'full'",
    "[ensemble]\nmodel = 'fulll'": "ensemble.model: 'fulll' is not accepted; it should be 'full'",
    "[ensemble]\nrtol = 1e-30": "ensemble.rtol: 1e-30 is not accepted",
    "[ensemble]\noutputs_per_tide = 1e9": "ensemble.keep: 1000 is not accepted; with outputs_per",
    "[wind]\nmonths = []": "wind.months: [] is not accepted; it should have at least 1 item",
    "[wind]\nmonths = [6, 13]": "wind.months.1: 13 is not accepted",
    # Types: nothing is guessed.
    "[scenario]\nepsilon = '0.02'": "scenario.epsilon: '0.02' is not accepted; it should be a vali",
    "[scenario]\nepsilon = true": "scenario.epsilon: True is not accepted",
    "[scenario]\nname = 3": "scenario.name: 3 is not accepted; it should be a valid string",
    "[scenario]\nname = 2020-01-01": "scenario.name: datetime.date(2020, 1, 1) is not accepted",
    "[scenario]\nposition = 1": "scenario.position: 1 is not accepted; it should be a list",
    "[scenario]\nposition = [1]": "scenario.position.1: is missing",
    "[scenario]\nposition = [1, 2, 3]": "scenario.position: [1, 2, 3] is not accepted",
    "[scenario]\nposition = [1, 'a']": "scenario.position.1: 'a' is not accepted",
    "[ensemble]\nmembers = '5'": "ensemble.members: '5' is not accepted",
    "[ensemble]\nmembers = 2.5": "ensemble.members: 2.5 is not accepted",
    "[ensemble]\nwind_terms = 'no'": "ensemble.wind_terms: 'no' is not accepted",
    "[wind]\nmonths = ['June']": "wind.months.0: 'June' is not accepted",
    "scenario = 3": "scenario: 3 is not accepted; it should be a table",
    "wind = [1]": "wind: [1] is not accepted; it should be a table",
    "[scenario]\nsea = 3": "scenario.sea: 3 is not accepted",
    "[scenario]\ncoast = 'beach'": "scenario.coast: 'beach' is not accepted",
    # Unknown keys at every depth.
    "[scenaro]": "scenaro: unknown key; did you mean 'scenario'?",
    "foo = 1": "foo: unknown key; known: scenario, wind, ensemble",
    "self = 1": "self: unknown key; known: scenario",
    "[scenario]\nepsilom = 1": "scenario.epsilom: unknown key; did you mean 'epsilon'?",
    "[wind]\nrecrod = 'a'": "wind.recrod: unknown key; did you mean 'record'?",
    "[ensemble]\nmember = 1": "ensemble.member: unknown key; did you mean 'members'?",
    "[scenario.coast]\nradus = 1": "scenario.coast.radus: unknown key; did you mean 'radius'?",
    "[scenario.coast]\nkind = 'circle'\nradus = 1": "scenario.coast.radus: unknown key; did you",
    "[scenario.sea.tide]\nmaen = 1": "scenario.sea.tide.maen: unknown key; did you mean 'mean'?",
    # Coasts.
    "[scenario.coast]\nkind = 'square'": "coast.kind: 'square' is not accepted; it should be 'circ",
    "[scenario.coast]\nkind = 'polygons'": "scenario.coast.rings: is missing",
    "[scenario.coast]\nkind = 'polygons'\nrings = [[[0, 0], [1, 1]]]": "coast.rings.0: [[0, 0], [1",
    "[scenario.coast]\nradius = 0": "scenario.coast.radius: 0 is not accepted",
}


@pytest.mark.parametrize(("toml", "message"), REFUSED.items())
def test_refusals_name_field_value_and_what_is_accepted(toml: str, message: str) -> None:
    with pytest.raises(ScenarioError) as refusal:
        RunConfiguration.from_toml(toml)
    assert message in str(refusal.value)
    assert ";\n" not in str(refusal.value), "one fault, one sentence"


def test_every_fault_is_told_with_its_path() -> None:
    toml = "[scenario]\ndrag = -1\n[scenario.coast]\nradius = 0\nplace = 1\n[wind]\nshare = 1"
    with pytest.raises(ScenarioError) as refusal:
        RunConfiguration.from_toml(toml)
    sentences = str(refusal.value).split(";\n")
    assert [sentence.partition(":")[0] for sentence in sentences] == [
        "scenario.drag",
        "scenario.coast.radius",
        "scenario.coast.place",
        "wind.share",
    ]


@pytest.mark.parametrize(
    ("toml", "line"),
    [("[ensemble\n", 1), ("[ensemble]\nmembers = = 3", 2), ("a = 1\nb = 2\na = 3\n", 3)],
)
def test_syntax_errors_name_the_line(toml: str, line: int) -> None:
    with pytest.raises(ScenarioError, match=rf"not valid TOML: .*line {line}"):
        RunConfiguration.from_toml(toml)


def test_a_number_beyond_all_digits_is_a_syntax_error() -> None:
    with pytest.raises(ScenarioError, match="not valid TOML"):
        RunConfiguration.from_toml(f"[ensemble]\nmembers = {'9' * 5000}")


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "no such file"), (b"\xff\xfe", "is not UTF-8 text"), ("folder", "cannot be read")],
)
def test_files_that_cannot_be_read(content: Any, message: str, tmp_path: Path) -> None:
    path = tmp_path / "scenario.toml"
    if content == "folder":
        path.mkdir()
    elif content:
        path.write_bytes(content)
    with pytest.raises(ScenarioError, match=f"scenario.toml: {message}"):
        RunConfiguration.from_toml(path)


# In Python


@given(values=scenario_numbers())
def test_the_papers_case_takes_its_numbers(values: dict[str, Any]) -> None:
    scenario = dc.paper.scenario(**values)
    assert (scenario.position, scenario.velocity) == (values["x"], values["v"])
    hours = values["tide_period_h"] / values["epsilon"]
    assert scenario.duration_days == pytest.approx(hours / 24)


def test_numpy_and_lists_are_as_good_as_plain_numbers() -> None:
    plain = dc.paper.scenario(epsilon=0.25, x=(1.0, 2.0), drag=2.0)
    assert plain == dc.paper.scenario(np.float32(0.25), np.array([1, 2]), drag=np.int64(2))  # type: ignore[arg-type]
    seed: Any = np.uint64(2**64 - 1)
    assert EnsembleConfiguration(seed=seed).seed == 2**64 - 1


def test_replacing_validates_anew() -> None:
    scenario = dc.paper.scenario()
    assert scenario.replace(drag=2.0).drag == 2.0
    with pytest.raises(ScenarioError, match="drag: -1 is not accepted"):
        scenario.replace(drag=-1)
    with pytest.raises(ScenarioError, match="drga: unknown key; did you mean 'drag'"):
        scenario.replace(drga=1)


def test_configurations_are_frozen_and_compare_by_value() -> None:
    scenario = dc.paper.scenario()
    with pytest.raises(ValueError, match="frozen"):
        scenario.drag = 2.0  # type: ignore[misc]
    assert scenario == dc.paper.scenario()
    assert len({scenario, dc.paper.scenario(), scenario.replace(drag=2.0)}) == 2


def test_precision_is_sought_by_members_that_are_open() -> None:
    with pytest.raises(
        dc.ScenarioError, match=r'precision: 0\.02 is not accepted with members = 50; .* "auto" it'
    ):
        dc.RunConfiguration.from_toml("[ensemble]\nmembers = 50\nprecision = 0.02")
