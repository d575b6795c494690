"""What the program asks of a kind of test alone, seen by kinds that it does not have."""

import numpy as np
import pytest

import biaxbayes
from biaxbayes.errors import InputError
from biaxbayes.experiments import EXPERIMENTS, Experiment
from biaxbayes.experiments.experiment import Column, Loads, Points
from biaxbayes.experiments.tube import Tube
from biaxbayes.figures.specimen import protocols_figure
from biaxbayes.forward import ForwardModel
from biaxbayes.laws.goh import GOH
from biaxbayes.options import Settings
from biaxbayes.specimens.virtual_specimen import virtual_inflation
from biaxbayes.verbs.check import Checked

MATERIAL = GOH(15.0, 40.0, 4.0, 40.0, 0.15)
VALUES = {"C1": 15.0, "k1": 40.0, "k2": 4.0, "alpha": 40.0, "kappa": 0.15}
SECTION = 3.2e-3
"""Of two legs, N / kPa."""


class Legs(Experiment):
    """Two legs pulled along x without a mounted state, whose force is no load of a sheet."""

    name = words = meaning = "legs"
    loads = {"pull": Loads(("pull_N", ""), ("N", "N"), "pull", "pulls")}  # noqa: RUF012
    axes, free_side, is_mounted = (0,), 1, False

    def __init__(self, in_weights: bool) -> None:
        self.in_weights = in_weights

    def area(self, header, loads):
        return None if self.in_weights else np.array([SECTION, 1.0])

    def points(self, stretch):
        weight = np.zeros((len(stretch), 2, 2))
        weight[:, 0, 0] = (SECTION if self.in_weights else 1.0) / stretch[:, 0]
        return Points(stretch, weight, np.arange(len(stretch)))

    def paths(self, largest_stretch, along, increments, readings):
        around = np.linspace(1.0, largest_stretch, increments + 1)
        return {"1": np.column_stack([around, np.full(around.size, np.nan)])}

    def methods(self, header, paths):
        return ""


@pytest.mark.parametrize("in_weights", [True, False])
def test_a_force_acts_on_the_section_that_its_kind_of_test_states(monkeypatch, in_weights):
    """Not on the edges and the thickness of a sheet because its unit is N."""
    monkeypatch.setitem(EXPERIMENTS, "legs", Legs(in_weights))
    noise = {"N": 0.0, "kPa": 0.0}
    made, _ = virtual_inflation(
        MATERIAL, "legs", name="legs", thickness_mm=0.8, header={}, largest_stretch=1.3,
        increments=10, noise=noise, seed=0,
    )  # fmt: skip
    (p,) = made.protocols
    forward = ForwardModel.from_specimen(made, Settings())
    np.testing.assert_allclose(forward.load(VALUES, p.stretch)[0], p.recorded_load, rtol=1e-9)
    # neo-Hookean: F = 2 C1 A (l - 1 / l^2)
    read = forward.load(VALUES | {"k1": 0.0}, p.stretch)[0, :, 0]
    around = p.stretch_x
    np.testing.assert_allclose(read, 30.0 * SECTION * (around - around**-2), rtol=1e-9, atol=1e-12)
    section = Checked(made, ()).record()["section_x_mm2"]
    assert section == (None if in_weights else pytest.approx(1e3 * SECTION))


def test_convert_computes_the_stretch_of_a_length_as_its_column_says(monkeypatch, tmp_path):
    """Of any dimension in the header, not of one named as the column."""
    column = Column(
        "Distance", "required", ("stretch_x",), ("unloaded_length_mm",),
        lambda columns, header: (
            columns["outer_diameter_mm"] / (0.5 * np.pi * header["unloaded_length_mm"])
        ),
    )  # fmt: skip
    monkeypatch.setitem(Tube.columns, "outer_diameter_mm", column)
    around = np.linspace(1.0, 1.3, 30)
    path = tmp_path / "raw.csv"
    rows = [f"{4.0 * np.pi * x:.9g},1.1,{20.0 * (x - 1.0):.9g}" for x in around]
    path.write_text("\n".join(["outer_diameter_mm,stretch_z,pressure_kPa", *rows]))
    options = {"machine": "generic", "test": "tube", "thickness_mm": 0.9}
    options["unloaded_outer_diameter_mm"] = 3.0
    with pytest.raises(InputError, match="needs the unloaded_length_mm"):
        biaxbayes.convert(path, **options)
    made = biaxbayes.convert(path, unloaded_length_mm=8.0, **options)
    np.testing.assert_allclose(made.specimen.protocols[0].stretch_x, around, rtol=1e-8)


def test_a_picture_names_the_directions_that_it_shows():
    up = np.linspace(1.0, 1.2, 12)
    made = biaxbayes.Specimen(
        "strip", (biaxbayes.Protocol("1", up, np.full(12, np.nan), up - 1.0, 0.0 * up),), "piola",
        test="strip x",
    )  # fmt: skip
    (legend,) = protocols_figure(made).legends
    assert [text.get_text() for text in legend.get_texts()][:2] == ["x", "reference (at rest)"]


def test_edges_are_drawn_for_sheets_alone():
    drawn = {test: "edge_x_mm" in of.drawing for test, of in EXPERIMENTS.items()}
    assert drawn == {test: of.is_mounted for test, of in EXPERIMENTS.items()}
