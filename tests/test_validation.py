"""The validation on a small effort: numbers, words, files, and what happens when a check fails."""

import json
import math
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import driftcore as dc
from driftcore import cli, law, paper, validation, validation_report
from driftcore.check import Check
from driftcore.climate import synthetic_record
from driftcore.validation import Case, Errors, Integration, Validation
from driftcore.validation_wind import EMBEDDED
from driftcore.validation_wind_report import law_of_the_wind
from driftcore.wrong_winds import WRONG

SMALL = validation.Effort(
    winds=2,
    winds_of_orders=1,
    winds_of_costs=1,
    winds_of_printed=1,
    members=20,
    rounds=1,
    halvings=6,
    small_scale_paths=5,
)


@pytest.fixture(scope="module")
def record() -> dc.WindRecord:
    """Six summers that stand for a user's own."""
    return dc.read_record(synthetic_record(years=6, seed=2), months=(6, 7, 8), label="Six summers")


@pytest.fixture(scope="module")
def small(record: dc.WindRecord) -> Validation:
    return validation.measure(SMALL, record=record)


@pytest.fixture(scope="module")
def report(small: Validation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    validation_report.write(small, folder)
    return folder


def worse(small: Validation) -> Validation:
    """The same measurement with one error that is too large."""
    case = Case(50, "mean-flow", 1)
    errors = replace(small.errors[case], position=np.array([1e-3, 1.1e-3]))
    return replace(small, errors={**small.errors, case: errors})


def call(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> Any:
    monkeypatch.setattr(sys, "argv", ["driftcore", "validate", *arguments])
    with pytest.raises(SystemExit) as end:
        cli.main()
    return end.value.code


# The paper's tables


def test_printed_tables_are_whole() -> None:
    windows = {25: (0.1, 0.5, 1.0), 50: (0.1, 0.5, 1.0, 4.0, None), 100: (0.1, 0.5, 1.0, 4.0)}
    assert set(paper.PRINTED) == {(t, w) for t, row in windows.items() for w in row}
    for (tides, window), row in paper.PRINTED.items():
        for column, entry in enumerate(row):
            numbers = validation.printed_numbers(entry)
            assert len(numbers) == (1 if window is None else 3)
            if window is not None:
                mean, least, greatest = numbers
                assert least <= mean <= greatest
                # The slip of the paper: everything else lies close to its mean.
                assert (greatest > 4 * mean) == ((tides, window, column) == (100, 4.0, 0))


@pytest.mark.parametrize(
    ("key", "means"),
    [
        ((50, 0.1), [0.1115, 0.0460, 0.0174, 0.0023]),
        ((50, 4.0), [0.1192, 0.0542, 0.0174, 0.0065]),
        ((50, None), [0.1115, 0.0096, 0.0174, 0.0022]),
        ((100, 0.5), [0.0558, 0.0294, 0.0086, 0.0012]),
        ((25, 1.0), [0.2257, 0.1142, 0.0358, 0.0044]),
    ],
)
def test_printed_means(key: tuple[int, float | None], means: list[float]) -> None:
    assert [validation.printed_numbers(entry)[0] for entry in paper.PRINTED[key]] == means


# Measurements


def test_errors_are_those_of_the_trajectories(small: Validation) -> None:
    scenario, wind = dc.paper.scenario(1 / 25), dc.paper.default_wind()
    times = np.linspace(0, 1, 25 * 200 + 1)
    for member in range(SMALL.winds):
        path = dc.member_path(scenario, wind, member)
        full, averaged = (
            dc.trajectory(scenario, path, model=model, times=times)
            for model in ("full", "mean-flow")
        )
        for norm in ("velocity", "position"):
            expected = np.linalg.norm(full[norm] - averaged[norm], axis=1).max()
            found = getattr(small.errors[Case(25, "mean-flow", 1)], norm)[member]
            # 60 samples per tide miss up to 0.2 %.
            assert found == pytest.approx(expected, rel=4e-3)


def test_every_case_is_measured(small: Validation) -> None:
    for case, errors in small.errors.items():
        count = 1 if case.calm or case.tides == 200 else SMALL.winds
        for values in vars(errors).values():
            assert values.shape == (count,)
            assert (values > 0).all()
    for tides in validation.TIDES:
        for window in validation.WINDOWS:
            assert set(validation.paper_cases(tides, window)) <= set(small.errors)
    assert 0 < small.resolution < 0.02


def test_checks_of_the_errors_pass_and_have_names(small: Validation) -> None:
    checks = small.checks
    assert len({check.name for check in checks}) == len(checks) > 30
    # One wind is few for an order, and coarse Euler steps have not reached theirs.
    exact = [check for check in checks if "order in" not in check.name]
    assert all(check.passed for check in exact), [c for c in exact if not c.passed]


def test_check() -> None:
    assert Check("", 1.0, 1.0).passed
    assert not Check("", 1.1, 1.0).passed
    assert not Check("", 0.8, 1.1, 0.9).passed
    assert not Check("", math.nan, 1.0).passed
    assert Check.within("", -0.04, 0.04).passed
    assert not Check.within("", -0.041, 0.04).passed
    assert Check("", 0.0, 7e-4).required == "≤ 0.0007"
    assert Check("", 0.0, 2.1, 1.9).required == "1.9 to 2.1"
    assert Check.within("", 0.0, 0.04).required == "-0.04 to 0.04"


def test_a_failing_check_fails_the_validation(small: Validation) -> None:
    failed = [check.name for check in worse(small).checks if not check.passed]
    assert "ε = 1/50, wind, mean-flow order 1, position, mean over the winds" in failed
    assert not worse(small).passed


def test_work_for_an_error() -> None:
    work = np.array([[100.0, 200.0, 400.0], [100.0, 200.0, 400.0], [100.0, 200.0, 400.0]])
    error = np.array([[0.04, 0.01, 0.0025]] * 3)
    integration = Integration("second order", work, error)
    assert integration.work_for(0.0025) == pytest.approx(400)
    assert integration.work_for(0.02) == pytest.approx(100 * math.sqrt(2))
    assert integration.work_for(0.5) == 100  # met by the coarsest
    assert integration.work_for(0.0025 / 4) == pytest.approx(800)  # beyond the finest
    assert integration.order == pytest.approx(2)
    # A tolerance that changes the error, not the work.
    idle = Integration("idle", np.array([[300.0, 300.0, 500.0]]), np.array([[3.0, 1.0, 0.1]]))
    assert idle.work_for(2.0) == 300
    # An error that grows again counts to its last crossing.
    wavy = Integration("wavy", work[:1, [0, 1, 2, 2]] * [1, 1, 1, 2], np.array([[4, 1, 3, 1.0]]))
    assert wavy.work_for(2) == pytest.approx(400 * 2 ** (math.log(1.5) / math.log(3)))


def test_euler_in_the_form_of_the_paper_converges_to_the_full_model() -> None:
    scenario = dc.paper.scenario(1 / 50)
    path = dc.member_path(scenario, dc.paper.default_wind(), 0)
    errors = []
    for steps in (8, 16, 32):
        times, position = validation.expanded_euler(scenario, path, 1000, steps)
        assert times[-1] == scenario.duration
        full = dc.trajectory(scenario, path, model="full", times=times, rtol=1e-10)
        errors.append(np.linalg.norm(position - full["position"], axis=1).max())
    # First order: halving the step halves the error, but for a second-order part.
    assert errors[1] / errors[0] == pytest.approx(0.5, abs=0.02)
    assert errors[2] / errors[1] == pytest.approx(0.5, abs=0.01)


# The winds


def test_every_law_is_measured(small: Validation) -> None:
    laws = small.laws
    assert [(one.name, one.wind.mode, one.seasons) for one in laws] == [
        ("Six summers", "residual", 6),
        ("Six summers", "lgb", 6),
        (EMBEDDED, "residual", 20),
        (EMBEDDED, "lgb", 20),
    ]
    for one in laws:
        assert {c.name[:2] for c in one.checks} == {f"T{k}" for k in range(1, 10)}
        failed = {c.name for c in one.checks if not c.passed}
        assert failed == (law.COPIES if one.wind.mode == "lgb" else set())
        assert one.summary.passed


def test_the_default_mode_must_not_copy(small: Validation) -> None:
    copying = replace(small.laws[0], checks=small.laws[1].checks)
    assert copying.summary.measured == 2
    laws = [copying, *small.laws[1:]]
    failed = [c.name for c in replace(small, laws=laws).checks if not c.passed]
    assert copying.summary.name in failed


def test_a_wrong_wind_that_nothing_finds_fails(small: Validation) -> None:
    unseen = {name: [Check("T1", 0.0, 1.0)] for name in small.wrong}
    failed = {c.name for c in replace(small, wrong=unseen).checks if not c.passed}
    assert {f"wrong wind, {name}: statistics that find it" for name in WRONG} <= failed


def test_too_few_seasons_stop_it_early() -> None:
    frame = synthetic_record(years=4)
    few = dc.read_record(frame, months=(6, 7, 8))
    with pytest.raises(dc.RecordError, match=r"4 season\(s\) tell no standard errors"):
        validation.measure(SMALL, record=few)


# The report


def test_numbers_are_json(small: Validation, report: Path) -> None:
    text = (report / "validation.json").read_text(encoding="utf-8")
    numbers = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no number"))
    assert numbers["version"] == dc.__version__
    assert len(numbers["checks"]) == len(small.checks)
    assert {"name", "measured", "low", "high", "passed"} == set(numbers["checks"][0])
    assert len(numbers["errors"]) == len(small.errors)
    case = {"tides": 50, "model": "mean-flow", "order": 2, "calm": False}
    (row,) = [row for row in numbers["errors"] if case.items() <= row.items()]
    errors = small.errors[Case(50, "mean-flow", 2)]
    assert row["position"]["max"] == pytest.approx(errors.position.max(), rel=1e-5)
    assert {"full", "mean-flow order 1"} <= {row["label"] for row in numbers["strandings"]}
    assert [one["seasons"] for one in numbers["law_of_the_wind"]] == [6, 6, 20, 20]
    assert set(numbers["wrong_winds"]) == set(WRONG)
    residual, lgb = numbers["law_of_the_wind"][:2]
    assert {"h", "log_likelihood"} == set(residual["likelihood"][0])
    assert {"h", "b", "log_likelihood"} == set(lgb["likelihood"][0])


def test_words_have_the_numbers_and_the_figures(small: Validation, report: Path) -> None:
    text = (report / "validation.md").read_text(encoding="utf-8")
    for row in paper.PRINTED.values():
        assert f"| paper | {' | '.join(row)} |" in text
    for check in small.checks:
        assert f"| {check.name} | {check.measured:.4g} | {check.required} |" in text
    assert "nan" not in text
    figures = set(re.findall(r"\]\((figures/[^)]+)\)", text))
    assert figures == {f"figures/{path.name}" for path in (report / "figures").iterdir()}
    for name in figures:
        assert (report / name).read_bytes().startswith(b"\x89PNG")
        assert (report / name).stat().st_size < 250_000
    # Every row of a table has as many cells as its header.
    for table in re.findall(r"(?:^\|.*\|\n)+", text, flags=re.MULTILINE):
        assert len({line.count("|") for line in table.splitlines()}) == 1


def test_words_on_the_winds(small: Validation, report: Path) -> None:
    text = (report / "validation.md").read_text(encoding="utf-8")
    assert "`driftcore validate --record Six summers`" in text
    assert "The bands of Six summers are wider" in text
    assert "quantiles 8.3" in text
    for one in small.laws:
        for check in one.checks:
            assert f"{check.measured:.3g}" in text
    assert text.count("(warns)") == 4
    # Each chosen bandwidth stands out, with its likelihood.
    for one in small.laws:
        best = one.wind.likelihood["log_likelihood"][one.wind.likelihood["h"] == one.wind.h]
        assert any(f"**{value:.4f}**" in text for value in best)


def test_words_without_a_record(small: Validation) -> None:
    words = law_of_the_wind(small.laws[2:], small.wrong, 6, "figure.png")
    assert "Six summers" not in words
    assert "The bands of T1 and T2 are those for 17 seasons or more" in words


def test_words_on_a_mode_that_does_not_copy(small: Validation) -> None:
    one, other = small.laws[2:]
    words = law_of_the_wind([one, replace(other, checks=one.checks)], small.wrong, 6, "figure.png")
    assert "Neither mode copies its record" in words


def test_validate_prints_the_table(
    small: Validation,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    calls = []

    def measure(
        effort: validation.Effort, progress: validation.Progress, record: dc.WindRecord | None
    ) -> Validation:
        progress("something")
        calls.append((effort, record and (record.label, record.months)))
        return small if small.passed else replace(small, euler=[])

    file = tmp_path / "mine.csv"
    synthetic_record(years=1).to_csv(file)
    monkeypatch.setattr(validation, "measure", measure)
    call(monkeypatch)
    call(monkeypatch, "--full", "--record", str(file))
    call(monkeypatch, "--record", str(file), "--months", "8,7")
    call(monkeypatch, "--record", str(file), "--months", "all")
    assert calls == [
        (validation.DEFAULT, None),
        (validation.FULL, ("mine.csv", (6, 7, 8))),
        (validation.DEFAULT, ("mine.csv", (7, 8))),
        (validation.DEFAULT, ("mine.csv", (6, 7, 8))),
    ]
    out = capsys.readouterr().out
    assert all(word in out for word in ("measured", "required", "0.0007", "ok"))
    code = call(monkeypatch, "--json")
    told = json.loads(capsys.readouterr().out)
    assert told["passed"] == (code == 0) == all(check["passed"] for check in told["checks"])
    assert [check["name"] for check in told["checks"]] == [check.name for check in small.checks]
    assert {"measured", "low", "high"} <= told["checks"][0].keys()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--record", "no.csv"], "there is no file 'no.csv'"),
        (["--record", "no.csv", "--months", "June"], "months: 'June' is not accepted"),
        (["--months", "6"], "months: they are those of a record"),
    ],
)
def test_records_that_do_not_serve(
    arguments: list[str],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(validation, "measure", lambda *_: pytest.fail("measured in vain"))
    assert call(monkeypatch, *arguments) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("to_folder", [False, True])
def test_a_failing_check_gives_exit_code_1(
    small: Validation,
    to_folder: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    monkeypatch.setattr(validation, "measure", lambda *_: worse(small))
    monkeypatch.setattr(validation_report, "_draw", lambda *_: None)  # takes seconds
    arguments = ["-o", str(tmp_path / "new" / "report")] if to_folder else []
    assert call(monkeypatch, *arguments) == 1
    assert "not met" in capsys.readouterr().out
    if to_folder:
        text = (tmp_path / "new" / "report" / "validation.md").read_text(encoding="utf-8")
        assert "**no**" in text


def test_all_checks_passed_gives_exit_code_0(
    small: Validation, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Validation, "checks", [Check("fine", 1.0, 2.0)])
    monkeypatch.setattr(validation, "measure", lambda *_: small)
    assert call(monkeypatch) == 0


def test_a_report_is_replaced_only_when_asked(
    small: Validation,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    (tmp_path / "validation.md").write_text("mine")
    monkeypatch.setattr(validation, "measure", lambda *_: pytest.fail("measured in vain"))
    assert call(monkeypatch, "-o", str(tmp_path)) == 2
    assert "exists; choose another name or ask to overwrite" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["validation.md"]
    assert (tmp_path / "validation.md").read_text() == "mine"

    def write(_: Validation, folder: Path) -> None:
        (folder / "figures").mkdir()
        for name in ("validation.md", "validation.json", "figures/one.png"):
            (folder / name).write_text("ours")

    monkeypatch.setattr(validation, "measure", lambda *_: small)
    monkeypatch.setattr(validation_report, "write", write)
    call(monkeypatch, "-o", str(tmp_path), "--overwrite")
    assert (tmp_path / "validation.md").read_text() == "ours"
    assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")) == [
        "figures",
        "figures/one.png",
        "validation.json",
        "validation.md",
    ]


def test_nothing_is_half_written(
    small: Validation, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fail(*_: Any) -> None:
        raise dc.OutputError("no more space")

    monkeypatch.setattr(validation, "measure", lambda *_: small)
    monkeypatch.setattr(validation_report.plot, "save_member", fail)
    assert call(monkeypatch, "-o", str(tmp_path / "report")) == 2
    assert list(tmp_path.iterdir()) == []


def test_machine_names_processors_and_python() -> None:
    assert re.search(r"\d+ processors, \w+, Python 3\.\d+", validation_report.machine())


def test_errors_of_one_wind_have_no_range() -> None:
    one = Errors(*np.full((5, 1), 0.25))
    assert validation_report._spread(one.velocity) == "0.250"
    assert validation_report._spread(np.array([0.1, 0.2]), 2) == "0.15 [0.10,0.20]"


def test_no_errors_have_no_summary() -> None:
    assert validation._summary(np.zeros(0)) == {}
    found = validation._summary(np.arange(101.0))
    assert found == {"mean": 50, "min": 0, "max": 100, "q5": 5, "q50": 50, "q95": 95}


def test_the_full_effort_strands_by_the_system_of_the_paper_too() -> None:
    effort = replace(SMALL, members=6, paper_strandings=True)
    found = validation._strandings(effort)
    labels = ["full", validation.MEAN_FLOW_1, validation.MEAN_FLOW_2]
    assert [case.label for case in found] == [*labels, validation.PAPER, validation.PAPER_WITHOUT]
    # All follow the same winds: whoever strands does so at about the same time and place.
    for case in found:
        assert case.different <= 1
        assert (case.distance < 0.02).all()
