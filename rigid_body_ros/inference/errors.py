# Copyright 2026 The rigid_body_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The errors of a fit, for the fitted samples and for the samples held back for validation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.inference.coordinates import Physics
from rigid_body_ros.inference.fit import errors_of, Solution
from rigid_body_ros.inference.noise import rms, tail
from rigid_body_ros.inference.windows import corrected, Window
from rigid_body_ros.mechanics import so3
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording.measured import Measured

#: Largest lag at which an autocorrelation is computed, in samples.
_LONGEST = 2000
#: A validation sample is an outlier if its error exceeds this multiple of both the median error
#: and the noise.
_OUTLIER = 8.0


@dataclass(frozen=True, eq=False)
class Residuals:
    """
    The errors of one quantity of one topic.

    Attributes
    ----------
    recording : int
        Index of the recording, starting from 0.
    topic : str
    is_attitude : bool
        True for attitudes, False for angular velocities.
    is_training : bool
        Whether the fit used these samples.
    stamps_ns : array of int64, shape (n,), ns
        The stamps as recorded.
    errors : array, shape (n, 3)
        Predicted minus measured values in sensor axes, as rotation vectors (rad) or angular
        velocities (rad/s).
    measured : array, shape (n, 4) or (n, 3)
        The measured attitudes or angular velocities.
    inliers : array of bool, shape (n,)
        Which samples are not outliers.
    noise : float
        Standard deviation of each component of a measurement, whether given or estimated.

    """

    recording: int
    topic: str
    is_attitude: bool
    is_training: bool
    stamps_ns: Ints
    errors: Floats
    measured: Floats
    inliers: NDArray[np.bool_]
    noise: float

    @property
    def name(self) -> str:
        """
        Return the topic and the quantity as text.

        In all but the first recording, the number of the recording follows in brackets.
        """
        quantity = 'attitude' if self.is_attitude else 'angular_velocity'
        return f'{self.topic} {quantity}' + (f'[{self.recording + 1}]' if self.recording else '')

    @property
    def kept(self) -> Floats:
        """Return the errors without outliers."""
        return self.errors[self.inliers]

    @property
    def kept_ns(self) -> Ints:
        """Return the stamps of the errors in `kept`, ns."""
        return self.stamps_ns[self.inliers]

    @property
    def computed(self) -> Floats:
        """Return the predicted attitudes or angular velocities."""
        return so3.multiply(self.measured, so3.exp(self.errors)) if self.is_attitude \
            else self.measured + self.errors

    def chi_square(self, rows: NDArray[np.bool_]) -> tuple[float, float]:
        """Return the chi-square of some errors, and the probability that noise exceeds it."""
        errors = self.errors[rows] / self.noise
        square = float(np.sum(errors ** 2))
        return square, tail(square, errors.size)

    @property
    def autocorrelation(self) -> float:
        """Return the correlation between adjacent errors, which is 0 for white noise."""
        total = float(np.sum(self.kept ** 2))
        return float(np.sum(self.kept[1:] * self.kept[:-1])) / total if total else 0.0


def unexplained(parts: Sequence[Residuals]) -> tuple[str, float]:
    """
    Return what a model leaves unexplained of one quantity, as text and as a number.

    For an angular velocity, this is the rms error relative to the rms of the measurement; for an
    attitude, the rms error, rad.
    """
    size, whole = (rms(np.concatenate([getattr(part, name) for part in parts]))
                   for name in ('kept', 'measured'))
    if parts[0].is_attitude:
        return f'{size:.2g} rad of the attitude', size
    part = size / max(whole, 1e-12)
    return f'{100.0 * part:.2g} % of the angular velocity', part


@dataclass(frozen=True)
class Misfit:
    """
    How well a model fits the measurements.

    Attributes
    ----------
    samples, outliers : int
        Total number of samples, and number of outliers among them. All other attributes ignore
        the outliers.
    attitude_rms, rate_rms : float or None
        Root-mean-square errors, rad and rad/s. None if the quantity was not measured.
    chi2_per_dof : float or None
        Chi-square per degree of freedom. Chi-square is the sum of the squared errors, each divided
        by its variance, and the degrees of freedom are the number of errors minus the number of
        unknowns. If the noise was estimated from these same errors, the ratio is 1.

    """

    samples: int
    outliers: int
    attitude_rms: float | None
    rate_rms: float | None
    chi2_per_dof: float | None

    @classmethod
    def of(cls, residuals: Sequence[Residuals], unknowns: int) -> Misfit:
        """Compute the misfit from the errors of a fit that has the given number of unknowns."""
        def component_rms(is_attitude: bool) -> float | None:
            values = np.concatenate([np.empty(0), *(part.kept.ravel() for part in residuals
                                                    if part.is_attitude == is_attitude)])
            return float(np.sqrt(np.mean(values ** 2))) if values.size else None
        inliers = np.concatenate([part.inliers for part in residuals])
        freedom = 3 * int(inliers.sum()) - unknowns
        chi2 = sum(part.chi_square(part.inliers)[0] for part in residuals)
        return cls(len(inliers), int(np.sum(~inliers)), component_rms(True), component_rms(False),
                   chi2 / freedom if freedom > 0 else None)

    def as_dict(self) -> dict[str, Any]:
        """Return the fields under the names used in the JSON file."""
        return {'samples': self.samples, 'outliers': self.outliers,
                'attitude_rms_rad': self.attitude_rms, 'rate_rms_rad_s': self.rate_rms,
                'chi2_per_dof': self.chi2_per_dof}


def correlations(errors: Floats, inliers: NDArray[np.bool_]) -> Floats:
    """
    Return the autocorrelation of errors for lags of 0 to m samples, shape (m + 1, 3).

    The largest lag m is a quarter of the number of samples, but at most 2000. Outliers are
    ignored.
    """
    kept = inliers[:, None]
    errors = np.where(kept, errors, 0.0)
    most = min(len(errors) // 4, _LONGEST)
    pairs, products = (_products(values, most) for values in (kept.astype(float), errors))
    variance = products[0] / max(pairs[0, 0], 1.0)
    return np.asarray(products / np.maximum(pairs, 1.0) / np.where(variance > 0.0, variance, 1.0))


def _products(values: Floats, most: int) -> Floats:
    """For each lag from 0 to `most`, return the sum of the products of rows `lag` rows apart."""
    size = 2 * len(values)
    power = np.abs(np.fft.rfft(values, size, axis=0)) ** 2
    return np.asarray(np.fft.irfft(power, size, axis=0)[:most + 1])


def measured_inliers(residuals: Sequence[Residuals], physics: Physics,
                     origin_ns: int) -> list[Measured]:
    """Return the measurements without outliers, on the torque clock and in body axes."""
    channels: dict[str, list[Residuals]] = {}
    for part in residuals:
        channels.setdefault(part.name, []).append(part)
    measured = []
    for parts in channels.values():
        stamps_ns = np.concatenate([part.kept_ns for part in parts])
        values = np.concatenate([part.measured[part.inliers] for part in parts])
        measured.append(Measured(parts[0].topic, stamps_ns, *(
            (values, None) if parts[0].is_attitude else (None, values))))
    return corrected([*filter(len, measured)], physics, origin_ns)


def of_training(solution: Solution) -> list[Residuals]:
    """Return the errors of the samples that the fit used."""
    result = []
    for number, channels in enumerate(solution.problem.setup.channels):
        for channel, errors, inliers, weight in zip(
                channels, solution.errors[number], solution.inliers[number],
                solution.weights[number]):
            # With a clock offset, some samples may precede the start. Their errors are NaN.
            used = np.isfinite(errors[:, 0])
            result.append(Residuals(number, channel.topic, channel.is_attitude, True,
                                    channel.stamps_ns[used], errors[used],
                                    channel.values[used], inliers[used], float(weight.sigma)))
    return result


def ahead_of(solution: Solution, number: int, channels: Sequence[Measured]) -> tuple[int, Window]:
    """
    Return the index of the last fitted window of a recording, and a new window for validation.

    The validation window contains the samples of the recording that the fit did not use. Its
    motion starts from the state at the beginning of the last fitted window.
    """
    setup, windows = solution.problem.setup, solution.problem.windows
    k = max(k for k, window in enumerate(windows) if window.experiment == number)
    last = windows[k]
    rest = [channel.rows(slice(len(fitted), None))
            for channel, fitted in zip(channels, setup.channels[number])]
    make, = setup.makers_of(number, channels, 2 ** 62, solution.physics)
    whole = make()
    assert isinstance(whole.problem, Problem)
    return k, replace(whole, problem=whole.problem.replaced(start=last.problem.start),
                      is_first=last.is_first, axial=last.axial, channels=rest,
                      rows=[slice(0, len(channel)) for channel in rest])


def of_validation(solution: Solution, every: Sequence[Sequence[Measured]]) -> list[Residuals]:
    """
    Return the errors of the model's predictions of the samples that the fit did not use.

    Parameters
    ----------
    solution : Solution
        The fit.
    every : sequence of sequence of Measured
        The channels of each recording, including the samples that the fit did not use.

    """
    problem, result = solution.problem, []
    for number, channels in enumerate(every):
        k, ahead = ahead_of(solution, number, channels)
        predicted = ahead.predict(solution.physics, problem.reference.rows(k))
        for channel, errors, weight in zip(ahead.channels, errors_of(ahead.channels, predicted),
                                           solution.weights[number]):
            sizes, noise = np.linalg.norm(errors, axis=1), float(weight.sigma)
            limit = _OUTLIER * max(float(np.median(sizes)) if len(sizes) else 0.0, noise)
            result.append(Residuals(number, channel.topic, channel.is_attitude, False,
                                    channel.stamps_ns, errors, channel.values, sizes <= limit,
                                    noise))
    return result
