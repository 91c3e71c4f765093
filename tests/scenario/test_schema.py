"""The JSON Schema: what is shipped is what is made, it takes every good file and refuses bad ones."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from scenario_bench import make_messages
from test_scenario_errors import CASES
from test_scenario_fuzz import SEED

from hev_can_emu import config
from hev_can_emu.cli import main
from hev_can_emu.messages.database import load_database
from hev_can_emu.runtime.scenario_schema import schema_text

ROOT = Path(__file__).parents[2]
SHIPPED = ROOT / "scenarios" / "scenario.schema.json"


def validator(text: str) -> Any:
    schema = json.loads(text)
    jsonschema.Draft7Validator.check_schema(schema)
    return jsonschema.Draft7Validator(schema)


@pytest.fixture(scope="module")
def shipped() -> Any:
    return validator(SHIPPED.read_text())


@pytest.fixture(scope="module")
def small() -> Any:
    """The schema of the bench's network."""
    return validator(schema_text(make_messages()))


def test_the_shipped_schema_is_that_of_the_shipped_network(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    made = schema_text(load_database(ROOT / "dbc" / "hev.dbc").messages)
    hint = "run: hev-can-emu scenario schema --dbc dbc/hev.dbc > scenarios/scenario.schema.json"
    assert SHIPPED.read_text() == made, hint
    assert main(["scenario", "schema"]) == 0
    assert capsys.readouterr().out == made


def test_of_another_network_it_names_the_signals(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    dbc = tmp_path / "other.dbc"
    dbc.write_text(
        'VERSION ""\nNS_ :\nBS_:\nBU_: A B\n\nBO_ 256 Foo: 8 A\n SG_ Bar : 0|8@1+ (1,0) [0|99] "rpm" B\n'
    )
    assert main(["scenario", "schema", "--dbc", str(dbc)]) == 0
    schema = json.loads(capsys.readouterr().out)
    step = schema["$defs"]["Step"]["properties"]
    assert step["set"]["properties"] == {
        "Bar": {
            "description": "0 to 99 rpm; A sends it in Foo",
            "anyOf": [{"type": "number", "minimum": 0.0, "maximum": 99.0}, {"type": "string"}],
        }
    }
    assert step["ramp"]["propertyNames"] == {"enum": ["Bar", "Foo.Bar"]}


@pytest.mark.parametrize("path", sorted((ROOT / "scenarios").glob("*.yaml")), ids=lambda p: p.stem)
def test_every_shipped_scenario_fits_and_says_where_its_schema_is(path: Path, shipped: Any) -> None:
    assert list(shipped.iter_errors(config.read(path).data)) == []
    first = path.read_text().splitlines()[0]
    assert first == "# yaml-language-server: $schema=scenario.schema.json"


def test_the_examples_of_the_page_fit(shipped: Any) -> None:
    page = (ROOT / "docs" / "scenarios.md").read_text()
    for example in re.findall(r"```yaml\n(.*?)```", page, re.DOTALL):
        head = "" if "version:" in example else "version: 1\nname: x\n"
        assert list(shipped.iter_errors(config.parse(head + example).data)) == []


def test_the_seed_of_the_random_tests_fits(small: Any) -> None:
    assert list(small.iter_errors(SEED)) == []


#: What the schema cannot know: quantities, expressions, order, sums of times, names in expressions.
_BEYOND = re.compile(
    r"a number with a unit|a time |a condition|a signal or parameter|at most the timeout|"
    r"each name once|each signal once|steps in the order|a unit, got|a number, got the condition|"
    r"a number in|a number or a label, got 'Sped'|a number or a label, got 'Paralel'|got 1\.5 kNm|"
    r"got 500\.0 Nm|a value in|another value|a name of its own|a name of letters|"
    r"a parameter in use|a step's name|a window that|one end of the window|"
    r"no 'within' beside|'within' beside|'at' beside|a node that sends|sent by|'when' beside|"
    r"\.to: expected -400|each key once|labels"
)


@pytest.mark.parametrize(("text", "message"), CASES, ids=range(len(CASES)))
def test_it_refuses_what_it_can_know_to_be_wrong(text: str, message: str, small: Any) -> None:
    if "each key once" in message:
        return  # no data to look at
    refused = bool(list(small.iter_errors(config.parse(text).data)))
    if not _BEYOND.search(message):
        assert refused


def test_it_refuses_most_of_the_bad_ones_that_have_a_wrong_shape(small: Any) -> None:
    shaped = [text for text, message in CASES if not _BEYOND.search(message)]
    assert len(shaped) >= 14
