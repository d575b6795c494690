"""A study of four specimens and its population, sampled quickly."""

from dataclasses import replace
from functools import partial

import pytest

import quick_posteriors
import shared
from biaxbayes.laws.goh import GOH
from biaxbayes.populations.sampler import PopulationPlan
from biaxbayes.specimens.specimen_file import write_specimen
from biaxbayes.studies.record import members_of_study
from biaxbayes.studies.study_file import read_study
from biaxbayes.verbs import population as job
from biaxbayes.verbs.batch import run_study
from biaxbayes.verbs.population import sample_population

MATERIALS = {
    "a": GOH(14.0, 60.0, 8.0, 38.0, 0.1),
    "b": GOH(11.0, 75.0, 7.0, 42.0, 0.1),
    "c": GOH(6.0, 30.0, 5.0, 55.0, 0.1),
    "d": GOH(7.0, 24.0, 6.0, 51.0, 0.1),
}
STUDY = """
name = "<script>alert(1)</script>"
ess = 60
max_steps = 600
columns = ["disease"]
options = { noise = "independent", mounting = "exact" }
priors = { kappa = 0.1 }
"""
QUICK = {
    **{"ensembles": 4, "chains": 16, "warm_up": 60, "rounds": 1, "run_ess": 100.0},
    **{"first_block": 40, "max_steps": 80, "ess": 50.0},
}


def sample_study(folder, head, specimens):
    """Sample a study of specimens, each with its entries in the study file."""
    folder.mkdir()
    text = head
    for data, entries in specimens:
        write_specimen(data, folder / f"{data.name}.csv")
        text += f'\n[[specimen]]\nfile = "{data.name}.csv"\n'
        text += "".join(f'{key} = "{value}"\n' for key, value in entries.items())
    (folder / "study.toml").write_text(text)
    with quick_posteriors.runs_without_figures():
        run_study(read_study(folder / "study.toml"), folder / "study")


def made_study(folder):
    specimens = []
    for k, (name, material) in enumerate(MATERIALS.items()):
        data = quick_posteriors.specimen(material, increments=8, seed=k)
        disease = "healthy" if name in "ab" else "aneurysm"
        entries = {"donor": f"<b>D{k % 2}", "disease": disease}
        specimens.append((replace(data, name=name, layer="media"), entries))
    sample_study(folder, STUDY, specimens)


def quick_job(study, out, **changes):
    name, members = members_of_study(study)
    return partial(sample_population, name, members, out, anyway=True, **changes)


def made_population(study):
    """Its result, made once a test session: not to be written into."""

    def execute():
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(job, "PopulationPlan", lambda **k: PopulationPlan(**(k | QUICK)))
            return quick_job(study, study.parent / "population")()

    return shared.cached("population", execute)
