"""Parameter files: what is read back, and what is refused by name."""

import pytest
import yaml

from dlwpredict.effects import library
from dlwpredict.errors import InputError
from dlwpredict.files.parameters_yaml import parameters_as_dict, parameters_from, read_parameters, write_parameters
from dlwpredict.files.yaml_text import yaml_text
from dlwpredict.parameters import Paper, ParameterSet, Process, Readings, Undecided, Writing

GOOD = parameters_as_dict(ParameterSet())


def test_no_file_means_the_papers_defaults():
    assert read_parameters(None) == ParameterSet()
    assert read_parameters("configs/paper-defaults.yaml").paper == Paper()


def test_everything_comes_back(tmp_path):
    full = ParameterSet(
        paper=Paper(threshold=0.437, exposure_fwhm_xy_um=0.1),
        writing=Writing(slicing_um=0.1),
        readings=Readings(crosslink_reference="bulk"),
        effects=(library()["vignetting"](strength=0.05), library()["dose-memory"](gain=1e-3)),
        bounds={"threshold": (0.3, 0.6), "dose-memory.gain": (0.0, 0.2)},
        intervals={"threshold": (0.4, 0.5)},
        provenance={"command": "dlwpredict calibrate", "inputs": {"a.tif": "00ff"}},
        undecided=Undecided(
            ("vignetting",),
            print=Process(Paper(threshold=0.437), (library()["vignetting"](strength=0.05),)),
            measurement=Process(Paper(threshold=0.4), (library()["field-curvature"](sag_um=-0.07),)),
        ),
    )
    path = tmp_path / "p.yaml"
    write_parameters(path, full)
    assert read_parameters(path) == full


@pytest.mark.parametrize("value", [1e-5, 1e22, 0.1, 3.0, 1e-300])
def test_floats_read_back_as_floats(value):
    assert yaml.safe_load(yaml_text({"value": value})) == {"value": value}
    assert isinstance(yaml.safe_load(yaml_text({"value": value}))["value"], float)


def test_scientific_notation_without_a_point_is_a_number():
    """PyYAML hands 5e-1 over as text."""
    assert parameters_from(GOOD | {"threshold": "5e-1"}).paper.threshold == 0.5


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"format": "dlwpredict-parameters/2"}, "format: found dlwpredict-parameters/2"),
        ({"treshold": 0.5}, "treshold: unknown key"),
        ({"threshold": "half"}, "threshold: found 'half', allowed: a number"),
        ({"threshold": True}, "threshold: found True"),
        ({"threshold": 1.5}, "threshold: found 1.5, allowed 0.05 to 0.95"),
        ({"threshold": float("nan")}, "threshold: found nan"),
        ({"shrinkage_min": 1.05}, "shrinkage_min: found 1.05, at most shrinkage_max = 1"),
        ({"writing": {"slicing": 0.1}}, "writing.slicing: unknown key"),
        ({"writing": {"slicing_um": -0.1}}, "writing.slicing_um: found -0.1"),
        ({"writing": {"fast_axis": "x"}}, "writing.fast_axis: found x"),
        ({"writing": 3}, "writing: found 3"),
        ({"readings": {"threshold_reference": "mine"}}, "readings.threshold_reference: found mine"),
        ({"effects": [{"name": "magic"}]}, "effects.name: found 'magic'"),
        ({"effects": ["vignetting"]}, "effects.name: found 'vignetting'"),
        ({"effects": [{"name": ["magic"]}]}, "effects.name: found ['magic']"),
        ({"effects": {"name": "vignetting"}}, "effects: found"),
        ({"effects": [{"name": "vignetting", "power": 1}]}, "vignetting.power: unknown key"),
        ({"effects": [{"name": "vignetting", "strength": 7}]}, "vignetting.strength: found 7"),
        ({"effects": [{"name": "vignetting"}, {"name": "vignetting"}]}, "effects.vignetting: named twice"),
        ({"bounds": {"threshold": [0.6, 0.3]}}, "bounds.threshold: found"),
        ({"bounds": {"tilt": [0, 1]}}, "bounds.tilt: unknown key"),
        ({"intervals": {"threshold": 0.5}}, "intervals.threshold: found 0.5"),
    ],
)
def test_faults_are_refused_by_name(change, said):
    with pytest.raises(InputError) as refusal:
        parameters_from(GOOD | change)
    assert said in str(refusal.value)


DOME = GOOD | {"effects": [{"name": "field-curvature", "sag_um": -0.07}, {"name": "dose-memory", "gain": 0.1}]}
SEVEN = {name: value for name, value in GOOD.items() if hasattr(Paper, name)}
CURVED, FADING = ({**SEVEN, "effects": [DOME["effects"][1], other]} for other in (
    DOME["effects"][0], {"name": "vignetting", "strength": 0.04}))  # fmt: skip
OPEN = {"effects": ["field-curvature"], "print": FADING, "measurement": CURVED}


def test_undecided_effects_are_read():
    found = parameters_from(DOME | {"undecided": OPEN})
    assert found.undecided.effects == ("field-curvature",)
    memory = library()["dose-memory"](gain=0.1)
    assert found.undecided.print == Process(found.paper, (memory, library()["vignetting"](strength=0.04)))
    assert found.undecided.measurement == Process(found.paper, (memory, library()["field-curvature"](sag_um=-0.07)))
    assert parameters_from(DOME).undecided is None
    assert "undecided" not in parameters_as_dict(parameters_from(DOME))


@pytest.mark.parametrize(
    ("undecided", "said"),
    [
        (3, "undecided: found 3, allowed: a mapping"),
        ([{"effect": "field-curvature"}], "undecided: found [{'effect': 'field-curvature'}], allowed: a mapping"),
        (OPEN | {"both": FADING}, "undecided.both: unknown key, allowed: effects, print, measurement"),
        (
            OPEN | {"effects": ["magic"]},
            "undecided.effects: found ['magic'], allowed: a list of field-curvature, dose-",
        ),
        (OPEN | {"effects": "field-curvature"}, "undecided.effects: found 'field-curvature'"),
        (OPEN | {"effects": [["field-curvature"]]}, "undecided.effects: found [['field-curvature']]"),
        (OPEN | {"effects": []}, "undecided.effects: found []"),
        ({"effects": ["field-curvature"], "print": FADING}, "undecided.measurement.exposure_fwhm_xy_um: missing"),
        (OPEN | {"print": "vignetting"}, "undecided.print: found 'vignetting', allowed: a mapping"),
        (OPEN | {"print": FADING | {"sag": 1}}, "undecided.print.sag: unknown key"),
        (OPEN | {"print": FADING | {"threshold": "half"}}, "undecided.print.threshold: found 'half'"),
        (OPEN | {"print": FADING | {"threshold": 7}}, "undecided.print.threshold: found 7"),
        (OPEN | {"print": FADING | {"effects": "vignetting"}}, "undecided.print.effects: found 'vignetting'"),
        (OPEN | {"print": FADING | {"effects": [{"name": ["a"]}]}}, "undecided.print.effects.name: found ['a']"),
        (OPEN | {"print": FADING | {"effects": [{"name": "curl"}] * 2}}, "undecided.print.effects.curl: named twice"),
    ],
)
def test_faults_of_undecided_effects_are_refused_by_name(undecided, said):
    with pytest.raises(InputError) as refusal:
        parameters_from(DOME | {"undecided": undecided})
    assert said in str(refusal.value) and "\n" not in str(refusal.value)


@pytest.mark.parametrize("name", ["threshold", "shrinkage_max", "crosslink_fwhm_z_um"])
def test_missing_parameters_are_refused_by_name(name):
    with pytest.raises(InputError, match=f"{name}: missing"):
        parameters_from({key: value for key, value in GOOD.items() if key != name})


@pytest.mark.parametrize(
    "text",
    [
        "!!python/object/apply:os.system ['true']",
        "threshold: !!python/float 0.5",
        "a: [1, 2",
        "threshold: 0.5\nthreshold: 0.6",
        "",
        "- 1",
        "\x00",
        "a: &a [*a]",
    ],
)
def test_files_that_are_no_plain_yaml_are_refused_with_their_name(tmp_path, text):
    path = tmp_path / "bad.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"bad\.yaml"):
        read_parameters(path)
