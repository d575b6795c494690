"""The points of a profile: continuation outwards with adaptive steps, and sweeps back over it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import gammaincinv

from biaxbayes.mechanics.mounting import BRACKET
from biaxbayes.options import CONTENT
from biaxbayes.parameters import DEGREE, Parameter
from biaxbayes.profiles.conditional_fit import FIRST_RISE, ConditionalFit, ConditionalLikelihood

# --- the axis of a profile: which scale, how far, in which steps ---------------------------------


LOWEST_OF_SCALE = 1e-4
"""Lower end of the axis of a positive scale, which stands for zero (kPa or 1)."""


class ProfiledParameter:
    """Scale, range and steps of a profiled parameter: natural logs, degrees or natural values."""

    def __init__(self, parameter: Parameter) -> None:
        self.parameter = parameter
        if parameter.logarithmic:
            ends = float(np.log(LOWEST_OF_SCALE)), float(np.log(parameter.largest))
            steps = 0.02, 1e-4, 0.8
        elif parameter.bounded:
            ends = parameter.range
            steps = (0.5, 1e-3, 5.0) if parameter.unit == DEGREE else (0.004, 1e-5, 0.02)
        else:
            ends, steps = BRACKET, (0.0005, 1e-6, 0.01)
        self.low, self.high = ends
        self.first_step, self.least_step, self.most_step = steps

    def place(self, value: float) -> float:
        """Place on the axis of a natural value."""
        if self.parameter.logarithmic:
            return float(np.log(max(value, LOWEST_OF_SCALE)))
        return float(value)

    def natural(self, at: float) -> float:
        """Natural value at a place on the axis."""
        if self.parameter.logarithmic:
            return 0.0 if at <= self.low else float(np.exp(at))
        return float(at)

    def anchors(self, centre: float) -> np.ndarray:
        """Places over the whole range where the profile is fitted from fresh starting points."""
        if self.parameter.logarithmic:
            steps = np.log([1e-3, 1e-2, 0.1, 0.3, 3.0, 10.0, 100.0])
            return np.unique(np.clip([self.low, *(centre + steps)], self.low, self.high))
        if self.parameter.bounded:
            return np.linspace(self.low, self.high, 9)
        return np.clip(centre + np.array([-0.05, -0.02, 0.02, 0.05]), self.low, self.high)


# --- the curve -----------------------------------------------------------------------------------


THRESHOLD = 2.0 * float(gammaincinv(0.5, CONTENT))
"""Deviance below which a value lies in the interval: chi-squared with one degree of freedom."""
MAX_EXCESS_DEVIANCE = 2.0  # deviance beyond the threshold at which the continuation ends
CEILING = THRESHOLD + MAX_EXCESS_DEVIANCE
"""The same deviance over the lowest, up to which a curve is drawn."""
DEVIANCE_STEP = (0.3, 1.2)  # of the deviance wanted from one step to the next
MAX_CURVE_STEPS = 80
SWEEPS = 3
EXTRA_STARTS = 4  # fresh starting points at an anchor
MAX_GAP_POINTS = 60  # maximum number of points put into gaps
LEVEL_GAP_WEIGHT = 0.3  # a gap counts by this fraction where the curve is level
MIN_IMPROVEMENT = 1e-4
MIN_LOWER_DEVIANCE = 0.02  # in deviance: less is the error of interpolating
THRESHOLD_TOLERANCE = 0.01  # of a point to the threshold, in deviance


class ProfileCurve:
    """Points of a profile in the order of the axis, from the overall optimum."""

    def __init__(self, likelihood: ConditionalLikelihood, axis: ProfiledParameter) -> None:
        self.likelihood, self.axis = likelihood, axis
        starts = [likelihood.fitted_start(), *likelihood.other_starts(None, EXTRA_STARTS)]
        best = self._lowest_from(None, starts)
        self.at = [axis.place(best.values[likelihood.parameter])]
        self.fits = [best]

    def run(self) -> None:
        """Extend the curve until the profile is complete."""
        self._continue()
        if self._anchor():
            self._fill()
            self._continue()
        if self.release():
            self._continue()
        for side in (-1, 1):
            self.refine(side)

    def _continue(self) -> None:
        for _ in range(SWEEPS):
            for side in (-1, 1):
                self.extend(side)
            if not self.sweep():
                break

    def _anchor(self) -> bool:
        """Fit from new starts over the whole range; True if the profile was lower somewhere."""
        is_lower = False
        for at in self.axis.anchors(self.at[self.lowest]):
            at, best = float(at), self.fits[self.lowest]
            value = self.axis.natural(at)
            starts = [best.values, *self.likelihood.other_starts(value, EXTRA_STARTS)]
            new_fit = self._lowest_from(value, starts)
            if self.at[0] <= at <= self.at[-1]:
                here = float(np.interp(at, self.at, [f.deviance for f in self.fits]))
                lower = new_fit.deviance < here - MIN_LOWER_DEVIANCE
            else:
                lower = new_fit.deviance < best.deviance + THRESHOLD + MAX_EXCESS_DEVIANCE
            if lower and at not in self.at:
                self._add(at, new_fit)
                is_lower = True
        return is_lower

    def _fill(self) -> None:
        """Close gaps between points, from both of their ends."""
        for _ in range(MAX_GAP_POINTS):
            gaps = np.diff(self.at)
            low = np.array([min(self.rise(k), self.rise(k + 1)) for k in range(len(gaps))])
            gaps[low > CEILING] = 0.0
            level = np.abs(np.diff([f.deviance for f in self.fits])) < DEVIANCE_STEP[0]
            gaps[level] *= LEVEL_GAP_WEIGHT
            k = int(np.argmax(gaps))
            if gaps[k] <= 1.01 * self.axis.most_step:
                return
            at = 0.5 * (self.at[k] + self.at[k + 1])
            self._add(at, self.fit(at, k, k + 1))

    @property
    def lowest(self) -> int:
        """Position of the lowest deviance."""
        return int(np.argmin([f.deviance for f in self.fits]))

    def rise(self, k: int) -> float:
        """Deviance of a point above the lowest."""
        return self.fits[k].deviance - self.fits[self.lowest].deviance

    def fit(self, at: float, *neighbours: int) -> ConditionalFit:
        """The best fit at a place on the axis, from the points given."""
        value = self.axis.natural(at)
        fits = (self.likelihood.best(value, self.fits[k].values) for k in neighbours)
        return min(fits, key=lambda fit: fit.deviance)

    def extend(self, side: int) -> None:
        """Continue outwards from the outermost point until well beyond the threshold or the end."""
        step = self.axis.first_step
        for _ in range(MAX_CURVE_STEPS):
            end = 0 if side < 0 else len(self.at) - 1
            low, high = self.axis.low, self.axis.high
            at_end = self.at[end] <= low if side < 0 else self.at[end] >= high
            if self.rise(end) > CEILING or at_end:
                return
            at = float(min(max(self.at[end] + side * step, low), high))
            new_fit = self.fit(at, end)
            if not np.isfinite(new_fit.deviance):
                if step < self.axis.least_step:
                    return
                step *= 0.3
                continue
            change = new_fit.deviance - self.fits[end].deviance
            if change > DEVIANCE_STEP[1] and step > self.axis.least_step:
                step *= 0.4
                continue
            self._add(at, new_fit)
            if change < DEVIANCE_STEP[0]:
                step = min(1.7 * step, self.axis.most_step)

    def _lowest_from(
        self, value: float | None, starts: Sequence[Mapping[str, float]]
    ) -> ConditionalFit:
        """The lowest deviance at a value, from the two best of several starts."""
        first = [self.likelihood.best(value, start, FIRST_RISE) for start in starts]
        first.sort(key=lambda fit: fit.deviance)
        ends = [self.likelihood.best(value, fit.values) for fit in first[:2]]
        return min(ends, key=lambda fit: fit.deviance)

    def _add(self, at: float, new_fit: ConditionalFit) -> None:
        k = int(np.searchsorted(self.at, at))
        self.at.insert(k, at)
        self.fits.insert(k, new_fit)

    def sweep(self) -> bool:
        """Fit every point from its neighbours on either side; True if any is lower."""
        better = False
        for order in (range(1, len(self.at)), range(len(self.at) - 2, -1, -1)):
            for k in order:
                refit = self.fit(self.at[k], k - order.step)
                if refit.deviance < self.fits[k].deviance - MIN_IMPROVEMENT:
                    better = True
                if refit.deviance < self.fits[k].deviance:
                    self.fits[k] = refit
        return better

    def release(self) -> bool:
        """Fit with the parameter free from the lowest point; True if that is lower."""
        lowest = self.fits[self.lowest]
        freed = self.likelihood.best(None, lowest.values)
        if not freed.deviance < lowest.deviance:
            return False
        at = self.axis.place(freed.values[self.likelihood.parameter])
        if abs(at - self.at[self.lowest]) <= self.axis.least_step:
            self.at.pop(self.lowest)
            self.fits.remove(lowest)
        self._add(at, freed)
        return True

    def refine(self, side: int) -> None:
        """Bring a point close to where the curve crosses the threshold."""
        for _ in range(6):
            pair = self.crossing(side)
            if pair is None:
                return
            if min(abs(self.rise(k) - THRESHOLD) for k in pair) < THRESHOLD_TOLERANCE:
                return
            at = self.interpolated(*pair)
            if at in self.at:
                return
            new_fit = self.fit(at, *pair)
            if not np.isfinite(new_fit.deviance):
                return
            self._add(at, new_fit)

    def interpolated(self, inside: int, outside: int) -> float:
        """Where the curve crosses the threshold between two points."""
        # The root of the deviance is nearly linear in the parameter.
        a, b = (np.sqrt(max(self.rise(k), 0.0)) for k in (inside, outside))
        fraction = (np.sqrt(THRESHOLD) - a) / (b - a)
        return float(self.at[inside] + fraction * (self.at[outside] - self.at[inside]))

    def crossing(self, side: int) -> tuple[int, int] | None:
        """The outermost neighbours on a side between which the threshold is crossed."""
        order = range(len(self.at)) if side < 0 else range(len(self.at) - 1, -1, -1)
        below = [k for k in order if self.rise(k) <= THRESHOLD]
        outside = below[0] + side
        return (below[0], outside) if 0 <= outside < len(self.at) else None
