"""A population in a folder: finished runs in, a hierarchical posterior over specimens out."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import biaxbayes
from biaxbayes.errors import BiaxbayesError, InputError, Interrupted, RunError
from biaxbayes.jobs.opening import refuse_finished, removal_told
from biaxbayes.jobs.population_files import Member, PopulationFound, write_population
from biaxbayes.options import PopulationOptions
from biaxbayes.populations.model import (
    Grouping,
    PooledValue,
    PopulationPriors,
    design_of,
    pooled_values,
)
from biaxbayes.populations.result import Population, judged
from biaxbayes.populations.sampler import History, Plan, State, draw
from biaxbayes.populations.specimens import Source, individual_of, pooled_names
from biaxbayes.populations.tuning import Spreading, Tuning
from biaxbayes.runs import checkpoint
from biaxbayes.runs.folder import POPULATION, clear_leftovers, finish_moving, names_in, staged
from biaxbayes.runs.lock import folder_lock
from biaxbayes.runs.provenance import settings_table, specimen_digest
from biaxbayes.runs.run import open_run
from biaxbayes.sampling.proposal import TransportedMixture
from biaxbayes.sampling.sampler import Progress

__all__ = ["PopulationJob", "pack", "unpack"]


# --- the job -------------------------------------------------------------------------------------

LOW_WEIGHT = 0.5
UNLIKE_STRETCH = 1.25
"""Ratio of the largest strains from which specimens were stretched unlike."""


@dataclass
class PopulationJob:
    """A population to sample, and the folder it is kept in.

    Attributes
    ----------
    name : str
    members : list of Member
    folder : Path
    options : PopulationOptions
    priors : PopulationPriors
    anyway : bool
        Take specimens that are tentative, too.
    """

    name: str
    members: list[Member]
    folder: Path
    options: PopulationOptions = field(default_factory=PopulationOptions)
    priors: PopulationPriors = field(default_factory=PopulationPriors)
    anyway: bool = False

    def execute(
        self,
        *,
        resume: bool = False,
        overwrite: bool = False,
        progress: Callable[[Progress], None] = lambda p: None,
        stop: Callable[[], int] = lambda: 0,
    ) -> PopulationFound:
        """Sample the population and write every file.

        Raises
        ------
        InputError
            If the specimens make no population.
        RunError
            If the folder is in use, or holds something else or a finished population.
        Interrupted
            If stopped; what was done is saved.
        """
        progress(Progress("reading runs"))
        sources, left_out = self._opened()
        grouping, notes = self._grouped(sources)
        names = pooled_names(sources)
        values = self.priors.applied(
            pooled_values(sources[0].posterior.law, names, mounting=self.options.pool_mounting)
        )
        self._make_folder()
        with folder_lock(self.folder):
            clear_leftovers(self.folder)
            finish_moving(self.folder, POPULATION)
            refuse_finished(self.folder, POPULATION, resume=resume, overwrite=overwrite)
            plan = Plan(
                ess=self.options.ess,
                max_steps=self.options.max_steps,
                seed=self.options.seed,
                workers=self.options.processors,
            )
            identity = self._identity(sources, grouping, values, plan)
            state = self._resumed(identity, resume, progress)
            individuals = [individual_of(s, values, plan.ensembles) for s in sources]
            design = design_of(individuals, grouping, values, self.options, self.priors)
            sampled = draw(
                design,
                plan,
                lambda history: judged(grouping, values, history),
                state=state,
                on_block=lambda s: checkpoint.save(self.folder, s, identity, pack),
                progress=progress,
                stop=stop,
            )
            if sampled.interrupted:
                raise self._interruption(stop())
            progress(Progress("writing"))
            population = Population(
                self.name,
                tuple(sources),
                grouping,
                tuple(values),
                design,
                sampled,
                self.options.seed,
                left_out,
                notes,
            )
            gone = removal_told(progress, POPULATION)
            with staged(self.folder, gone, POPULATION) as aside:
                written = write_population(aside, population, identity)
            return replace(written, folder=self.folder)

    def _opened(self) -> tuple[list[Source], dict[str, str]]:
        """The runs that can be pooled, and why the others cannot."""
        usable = ("converged", "tentative") if self.anyway else ("converged",)
        sources, left_out = [], {}
        for member in self.members:
            if member.state not in usable:
                told = {"tentative": "tentative, not converged", "unusable": "did not converge"}
                reason = told.get(member.state, member.state)
                left_out[member.label] = f"{reason}: {member.reason}" if member.reason else reason
                continue
            try:
                run = open_run(member.folder)
                if run.state not in usable:
                    left_out[member.label] = f"its run is {run.state}"
                    continue
                sources.append(Source.of(member.label, run))
            except BiaxbayesError as error:
                left_out[member.label] = str(error)
        if len(sources) < 2:
            lost = "; ".join(f"{k}: {v}" for k, v in list(left_out.items())[:3])
            raise InputError(
                f"{len(sources)} of {len(self.members)} specimens can be pooled, and a population "
                f"needs two{f' ({lost})' if lost else ''}",
                remedy="sample longer with a larger max_steps, or add specimens",
            )
        return sources, left_out

    def _grouped(self, sources: list[Source]) -> tuple[Grouping, list[str]]:
        """Groups and donors, and what is to be said of them."""
        by_label = {m.label: m for m in self.members}
        kept = [by_label[s.label] for s in sources]
        donors = [m.donor or f"donor of {m.label}" for m in kept]
        grouping = Grouping(
            tuple(m.label for m in kept), tuple(m.group for m in kept), tuple(donors)
        )
        return grouping, _notes(kept, grouping, sources)

    def _make_folder(self) -> None:
        names = names_in(self.folder)
        if names and not names & {POPULATION, *checkpoint.NAMES}:
            raise RunError(
                f"{self.folder}: is a folder that is not a population's; choose another --out"
            )

    def _identity(
        self, sources: list[Source], grouping: Grouping, values: list[PooledValue], plan: Plan
    ) -> dict[str, Any]:
        """What the draws depend on."""
        runs = {}
        for source, group, donor in zip(sources, grouping.group, grouping.donor, strict=True):
            settings = json.dumps(settings_table(source.posterior), sort_keys=True, default=str)
            record = source.run.provenance
            runs[source.label] = {
                "group": group,
                "donor": donor,
                "specimen": specimen_digest(source.run.specimen)[:16],
                "settings": hashlib.sha256(settings.encode()).hexdigest()[:16],
                "beta": source.run.beta,
                "draws": str(record.get("files", {}).get("posterior.nc", ""))[:16],
            }
        options = {k: v for k, v in asdict(self.options).items() if k != "workers"}
        return {
            "biaxbayes": biaxbayes.__version__,
            "options": options,
            "priors": {v.name: _stated(v) for v in values}
            | {"eta": [self.priors.eta_donors, self.priors.eta_specimens]},
            "sampler": {"ensembles": plan.ensembles, "chains": plan.chains},
            "runs": runs,
        }

    def _resumed(
        self, identity: dict[str, Any], resume: bool, tell: Callable[[Progress], None]
    ) -> State | None:
        if not resume:
            return None
        state, note = checkpoint.load(self.folder, identity, unpack)
        if note:
            tell(Progress("resuming", note=note))
        return state

    def _interruption(self, signal: int) -> Interrupted:
        return Interrupted(
            f"interrupted, all saved in {self.folder}; the same command with --resume continues",
            signal,
        )


def _stated(value: PooledValue) -> dict[str, float]:
    return {k: v for k, v in vars(value).items() if k != "parameter"}


def _notes(members: list[Member], grouping: Grouping, sources: list[Source]) -> list[str]:
    """What a reader must know of the specimens before the numbers."""
    out = []
    nameless = [m.label for m in members if not m.donor]
    if nameless:
        out.append(
            f"no donor is stated for {_listed(nameless)}: each is taken as a donor of its own"
        )
    donors = len(grouping.donors)
    if donors == 1:
        out.append(
            "all specimens are of one donor, so how donors differ is not seen: sd_donors is that "
            "of the prior, and mean, new_specimen and new_donor are as wide as it makes them"
        )
    elif donors == len(members):
        out.append(
            "every donor gave one specimen: how the spread splits between donors and specimens is "
            "that of the prior; new_specimen holds both"
        )
    elif donors < 4:
        out.append(f"there are {donors} donors: sd_donors rests much on its prior")
    if len(members) < 4:
        out.append(f"there are {len(members)} specimens: the sds rest much on their priors")
    for group in grouping.groups:
        if len(grouping.members(group)) == 1:
            out.append(
                f"group {group} has one specimen: its mean is that specimen's within the spread "
                "that the other groups show"
                if len(grouping.groups) > 1
                else f"group {group} has one specimen"
            )
    out += _apart(grouping)
    out += _unlike(sources)
    weights = np.array([s.run.beta for s in sources])
    if np.median(weights) < LOW_WEIGHT:
        out.append(
            f"the readings of the specimens were weighed by {weights.min():.2g} to "
            f"{weights.max():.2g} because the law misses smoothly: widths of single specimens hold "
            "that misfit, so the sd between specimens comes out too small, and an error of the law "
            "that all specimens share does not average out"
        )
    return out


def _apart(grouping: Grouping) -> list[str]:
    """Groups that share no donor."""
    of = {g: {grouping.donor[i] for i in grouping.members(g)} for g in grouping.groups}
    names = list(of)
    pairs = [(a, b) for k, a in enumerate(names) for b in names[k + 1 :] if not of[a] & of[b]]
    if not pairs:
        return []
    told = "; ".join(f"{a} and {b}" for a, b in pairs[:3])
    return [f"no donor in common: {told}: their contrasts hold the differences of the donors"]


def _unlike(sources: list[Source]) -> list[str]:
    """Specimens that were tested or sampled differently."""
    out = []
    for key in ("mounting", "noise", "mounting_stretch", "noise_growth"):
        found = {str(getattr(s.posterior.settings, key)) for s in sources}
        if len(found) > 1:
            out.append(f"the runs differ in {key}: {', '.join(sorted(found))}")
    counts = sorted({len(s.run.specimen.protocols) for s in sources})
    if len(counts) > 1:
        few = [s.label for s in sources if len(s.run.specimen.protocols) == counts[0]]
        out.append(
            f"specimens were tested with {counts[0]} to {counts[-1]} protocols "
            f"({counts[0]}: {_listed(few)})"
        )
    tops = [s.largest_stretch for s in sources]
    low, high = min(tops), max(tops)
    if high - 1.0 > UNLIKE_STRETCH * (low - 1.0):
        few = [s.label for s, top in zip(sources, tops, strict=True) if top - low < high - top]
        out.append(
            f"specimens were stretched to {low:.3f} to {high:.3f} from the unloaded state (least: "
            f"{_listed(few)}): stress and stiffness are stated up to {low:.3f}, and the band of a "
            "new specimen goes beyond what those show"
        )
    return out


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - 4} more" if len(names) > 4 else ""
    return ", ".join(names[:4]) + more


# --- its state between two blocks, as the bytes of a checkpoint ----------------------------------

FORMAT = 2


def pack(state: State, identity: dict[str, Any]) -> bytes:
    """State and what it is a state of, as bytes."""
    arrays: dict[str, np.ndarray] = {}
    members = []
    for k, member in enumerate(state.members):
        arrays |= {f"m{k}.{n}": v for n, v in member.items() if isinstance(v, np.ndarray)}
        accepted = {n: v.tolist() for n, v in member["accepted"].items()}
        members.append({"rng": member["rng"], "accepted": accepted})
    tuning = state.tuning
    arrays |= {f"archive{i}": a for i, a in enumerate(tuning.archives)}
    for i, q in enumerate(tuning.proposals):
        arrays |= {f"q{i}.{n}": v for n, v in q.arrays().items()}
    arrays |= {"directions": tuning.directions, "steps": tuning.steps}
    if tuning.spreading is not None:
        arrays |= {f"spreading.{n}": v for n, v in vars(tuning.spreading).items()}
    if state.history is not None:
        arrays |= {f"h.{n}": v for n, v in state.history.arrays().items()}
    text = json.dumps(
        {
            "format": FORMAT,
            "identity": identity,
            "members": members,
            "specimens": len(tuning.archives),
            "sweeps": state.sweeps,
            "block": state.block,
            "every": state.history.every if state.history is not None else 0,
            "finished": state.finished,
        },
        default=int,
    )
    return checkpoint.sealed(arrays, text)


def unpack(data: bytes) -> tuple[State, dict[str, Any]]:
    """Inverse of :func:`pack`.

    Raises
    ------
    DamagedCheckpoint
        If the bytes are not what was written.
    RunError
        If another version wrote them.
    """
    arrays, stored = checkpoint.opened(data)
    try:
        if stored["format"] != FORMAT:
            raise RunError("has the checkpoint of another version; start again without --resume")

        def part(prefix: str) -> dict[str, np.ndarray]:
            return {n.removeprefix(prefix): v for n, v in arrays.items() if n.startswith(prefix)}

        members = []
        for k, plain in enumerate(stored["members"]):
            accepted = {n: np.array(v) for n, v in plain["accepted"].items()}
            members.append({**part(f"m{k}."), "rng": plain["rng"], "accepted": accepted})
        number = int(stored["specimens"])
        tuning = Tuning(
            tuple(arrays[f"archive{i}"] for i in range(number)),
            tuple(TransportedMixture.from_arrays(part(f"q{i}.")) for i in range(number)),
            arrays["directions"],
            arrays["steps"],
            Spreading(**spreading) if (spreading := part("spreading.")) else None,
        )
        own = part("h.")
        history = History.from_arrays(own, int(stored["every"])) if own else None
        state = State(
            tuning,
            members,
            history,
            int(stored["sweeps"]),
            int(stored["block"]),
            bool(stored["finished"]),
        )
        return state, dict(stored["identity"])
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        raise checkpoint.DamagedCheckpoint(f"is damaged ({type(error).__name__})") from None
