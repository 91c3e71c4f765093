"""From files to runs: includes, the matrix, values from outside."""

from __future__ import annotations

from pathlib import Path

import pytest

from hev_can_emu.errors import InputError
from hev_can_emu.runtime.scenario_runs import MAX_RUNS, read_runs, read_scenario

HEAD = "version: 1\nname: test\nduration: 10 s\n"


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def write(**files: str) -> Path:
    for name, text in files.items():
        Path(f"{name}.yaml").write_text(text)
    return Path("main.yaml")


def test_an_included_files_lists_come_first_and_the_own_parameters_count() -> None:
    path = write(
        main=HEAD
        + "include: [a.yaml, sub.yaml]\nparameters: {p: 3 Nm}\nsteps:\n- {name: own, at: 3 s}\n",
        a="parameters: {p: 1 Nm, q: 2 s}\nsteps:\n- {name: a, at: 1 s}\nsetup:\n- {after: q}\n",
        sub="include: deep.yaml\nexpectations:\n- {always: t >= 0 s}\n",
        deep="version: 1\ndescription: x\nsteps:\n- {name: deep, at: 2 s}\n",
    )
    document, scenario = read_scenario(path)
    assert scenario.parameters == {"p": "3 Nm", "q": "2 s"}
    assert [step.name for step in scenario.steps] == ["a", "deep", "own"]
    assert len(scenario.setup) == len(scenario.expectations) == 1
    assert document.where(("steps", 1, "at")) == "deep.yaml:4: $.steps[1].at"
    assert document.where(("steps", 2, "at")) == "main.yaml:7: $.steps[2].at"
    assert document.where(("parameters", "q")) == "a.yaml:1: $.parameters.q"


def test_an_entry_of_a_list_includes_that_list_of_a_file() -> None:
    path = write(
        main=HEAD + "steps:\n- {name: first}\n- include: launch.yaml\n- {name: last}\n",
        launch="parameters: {torque: 3 Nm}\nsteps:\n- {name: one}\n- {name: two}\n"
        "expectations:\n- {always: t > 1 s}\n",
    )
    _, scenario = read_scenario(path)
    assert [step.name for step in scenario.steps] == ["first", "one", "two", "last"]
    assert scenario.parameters == {"torque": "3 Nm"}
    assert scenario.expectations == ()


def test_a_file_is_looked_for_beside_the_one_that_includes_it() -> None:
    Path("sub").mkdir()
    Path("sub/a.yaml").write_text("include: b.yaml\n")
    Path("sub/b.yaml").write_text("steps:\n- {name: b}\n")
    path = write(main=HEAD + "include: sub/a.yaml\n")
    assert [step.name for step in read_scenario(path)[1].steps] == ["b"]


@pytest.mark.parametrize(
    ("files", "message"),
    [
        (
            {"main": HEAD + "include: a.yaml\n", "a": "steps: []\ninclude: main.yaml\n"},
            "a.yaml:2: $.include: expected files that do not include one another, "
            "got 'main.yaml' includes 'a.yaml' includes 'main.yaml'",
        ),
        (
            {"main": HEAD + "include: main.yaml\n"},
            "main.yaml:4: $.include: expected files that do not include one another, "
            "got 'main.yaml' includes 'main.yaml'",
        ),
        (
            {"main": HEAD + "include: lanch.yaml\n", "launch": "steps: []\n"},
            "main.yaml:4: $.include: expected a YAML file, got 'lanch.yaml': no such file; "
            "did you mean 'launch.yaml' or 'main.yaml'?",
        ),
        (
            {"main": HEAD + "include: 3\n"},
            "main.yaml:4: $.include: expected a file's name, got 3",
        ),
        (
            {"main": HEAD + "steps:\n- include: a.yaml\n", "a": HEAD},
            "a.yaml:2: $.name: expected a key that an included file can have, got 'name'; "
            "known: include, parameters, setup, steps, teardown, expectations, version, description",
        ),
        (
            {"main": HEAD + "include: a.yaml\n", "a": "steps:\n- {name: x, sett: {}}\n"},
            "a.yaml:2: $.steps[0].sett: expected a known key, got 'sett'; "
            "did you mean 'set' or 'sine' or 'send'?",
        ),
        (
            {"main": HEAD + "include: a.yaml\n", "a": "steps: [\n"},
            "a.yaml:2:1: expected YAML, got did not find expected node content "
            "(while parsing a flow node)",
        ),
        (
            {"main": HEAD + "matrix: {torqe: [1 Nm]}\nparameters: {torque: 1 Nm}\n"},
            "main.yaml:4: $.matrix.torqe: expected a parameter or a field of the head, "
            "got 'torqe'; did you mean 'torque'?",
        ),
        (
            {"main": HEAD + "matrix: {seed: [1, 2, 1]}\n"},
            "main.yaml:4: $.matrix.seed[2]: expected each value once, got '1' again",
        ),
        (
            {"main": HEAD + "matrix: {seed: [1, x]}\n"},
            "main.yaml:4: $.matrix.seed[1]: expected a whole number, got 'x'",
        ),
        (
            {"main": HEAD + "matrix: {seed: []}\n"},
            "main.yaml:4: $.matrix.seed: expected a list of length >= 1, got an empty list",
        ),
        (
            {
                "main": HEAD
                + f"matrix:\n  a: {list(range(40))}\n  seed: {list(range(26))}\nparameters: {{a: 1}}\n"
            },
            "main.yaml:4: $.matrix: expected at most 1000 runs, got 1040; split the matrix",
        ),
    ],
)
def test_one_line_says_what_is_wrong(files: dict[str, str], message: str) -> None:
    with pytest.raises(InputError) as caught:
        read_runs(write(**files))
    assert str(caught.value) == message


def test_the_matrix_gives_every_combination_the_last_key_fastest() -> None:
    path = write(
        main=HEAD
        + "parameters: {torque: 1 Nm, time: 1 s}\nmatrix:\n  torque: [100 Nm, 150 Nm]\n"
        + "  model: [4dof, 16dof]\n"
    )
    runs = read_runs(path)
    assert [run.label for run in runs] == [
        "torque=100 Nm, model=4dof",
        "torque=100 Nm, model=16dof",
        "torque=150 Nm, model=4dof",
        "torque=150 Nm, model=16dof",
    ]
    last = runs[-1].scenario
    assert last.name == "test [torque=150 Nm, model=16dof]"
    assert (last.model, last.parameters) == ("16dof", {"torque": "150 Nm", "time": "1 s"})
    assert runs[2].locate(("parameters", "torque")) == "main.yaml:6: $.matrix.torque[1]"
    assert runs[2].locate(("parameters", "time")) == "main.yaml:4: $.parameters.time"
    assert MAX_RUNS == 1000


def test_a_value_from_outside_takes_its_name_out_of_the_matrix() -> None:
    path = write(main=HEAD + "parameters: {torque: 1 Nm}\nmatrix: {torque: [2 Nm, 3 Nm]}\n")
    (run,) = read_runs(path, {"torque": "7 Nm"})
    assert (run.label, run.scenario.parameters) == ("", {"torque": "7 Nm"})
    assert run.locate(("parameters", "torque")) == "--set torque"
    with pytest.raises(
        InputError, match=r"^--set: expected a parameter of main\.yaml, got 'torqe'"
    ):
        read_runs(path, {"torqe": "7 Nm"})
