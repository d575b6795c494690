"""Study files: what is read, and one line that names file and key for what cannot be."""

from __future__ import annotations

import pytest

from biaxbayes.errors import InputError
from biaxbayes.model.priors import Prior
from biaxbayes.studies.study_file import DEFAULT_OPTIONS, read_study, study_of_files

WHOLE = """
name = "three"
seed = 7
ess = 300
max_steps = 4000

[options]
noise = "independent"
thin = 80

[priors]
kappa = 0.2

[[specimen]]
file = "a.csv"

[[specimen]]
file = "sub/b.csv"
label = "second one"
donor = "D2"
layer = "media"
seed = 8
mounting_force = [0.015, 0]
options = { mounting = "zeroed", fibre_switch = true }

[specimen.priors]
kappa = 0.0
alpha = { distribution = "normal", mean = 41, sd = 3 }
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "sub").mkdir()
    for name in ("a.csv", "sub/b.csv"):
        (tmp_path / name).write_text("not read here\n")
    return tmp_path


def written(folder, text):
    path = folder / "study.toml"
    path.write_text(text)
    return path


def test_specimens_take_what_is_common_and_replace_what_is_their_own(folder):
    study = read_study(written(folder, WHOLE))
    assert (study.name, study.ess, study.max_steps) == ("three", 300.0, 4000)
    first, second = study.specimens
    assert first.file == folder / "a.csv"
    assert (first.label, first.donor, first.layer, first.seed) == ("a", None, None, 7)
    assert first.options == {
        **DEFAULT_OPTIONS,
        "noise": "independent",
        "thin": 80,
        "priors": {"kappa": 0.2},
    }
    assert (second.label, second.donor, second.layer, second.seed) == (
        "second one",
        "D2",
        "media",
        8,
    )
    assert second.mounting_force == (0.015, 0.0)
    assert second.options["mounting"] == "zeroed" and second.options["fibre_switch"] is True
    assert second.options["noise"] == "independent"
    assert second.options["priors"]["kappa"] == 0.0
    assert isinstance(second.options["priors"]["alpha"], Prior)


def test_a_study_without_a_name_has_that_of_its_file(folder):
    study = read_study(written(folder, '[[specimen]]\nfile = "a.csv"\n'))
    assert study.name == "study"
    assert study.specimens[0].options == {**DEFAULT_OPTIONS, "priors": {}}


A = '[[specimen]]\nfile = "a.csv"\n'
BAD = {
    "": "is empty; write its settings",
    "# nothing": "lists no specimen",
    "x =": "not valid TOML",
    "specimen = [3]": "specimen 1: is not a table",
    "sede = 3\n" + A: "'sede' is not a key of a study",
    "seed = -1\n" + A: "seed must be a whole number, at least 0",
    "ess = true\n" + A: "ess must be a number",
    'options = "x"\n' + A: "options must be a table",
    "[options]\nnoise = 'efective'\n" + A: "options: noise must be one of effective,",
    "[options]\nnois = 'effective'\n" + A: "'nois' is not a key of options",
    "[options]\nfibre_switch = 1\n" + A: "options: fibre_switch must be true or false",
    "[priors]\nkapa = 0.1\n" + A: "priors: unknown parameter 'kapa'",
    "[[specimen]]\n": "specimen 1: file must be the path",
    '[[specimen]]\nfile = "\\u0000"\n': "specimen 1: file must be the path",
    A + '[[specimen]]\nfile = "c.csv"\n': "specimen 2: file: no such file: ",
    A + A: "specimen 2: label 'a' is that of specimen 1",
    A + 'lable = "x"\n': "'lable' is not a key of specimen 1",
    A + 'layer = "  "\n': "specimen 1: layer must be text",
    A + "mounting_force = 3\n": "specimen 1: mounting_force must be two numbers",
    A + "priors = { alpha = 'x' }\n": "specimen 1: priors: alpha cannot be tied",
}


@pytest.mark.parametrize("text", BAD)
def test_what_cannot_be_used_is_one_line_with_file_and_key(folder, text):
    with pytest.raises(InputError) as raised:
        read_study(written(folder, text))
    message = str(raised.value)
    assert "\n" not in message
    assert "study.toml" in message
    assert BAD[text] in message


def test_files_make_a_study_of_their_own(folder):
    files = [folder / "a.csv", folder / "sub" / "b.csv"]
    study = study_of_files(files, {"noise": "independent"}, seed=3)
    assert [s.label for s in study.specimens] == ["a", "b"]
    assert {s.seed for s in study.specimens} == {3}
    with pytest.raises(InputError, match="no such file"):
        study_of_files([folder / "none.csv"], {})
    with pytest.raises(InputError, match="label 'a'"):
        study_of_files([files[0], files[0]], {})
    with pytest.raises(InputError, match="`ess` must be a number, at least 50"):
        study_of_files(files, {}, ess=3.0)
