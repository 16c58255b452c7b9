"""Decimated signals of a diagnosed record."""

from dataclasses import dataclass

from sgms_mhe.support.arrays import Array, Index, Mask


@dataclass(frozen=True)
class Traces:
    """Signals at the rate of the fit, all (m,).

    time [s] from the log's first sample to the instant of the row, position [m], velocity [m/s], acceleration [m/s^2],
    force [N], friction measured [N], simulated by the machine as it is, and by the extended model (parameters of all
    data); `held_out_fit_N` is the extended model fitted without the held-out segments.
    `used`: enters fits and numbers; `held_out`: not seen by the fit the gains are computed from.
    """

    time_s: Array
    position_m: Array
    velocity_m_s: Array
    acceleration_m_s2: Array
    force_N: Array
    friction_N: Array
    nominal_N: Array
    extended_N: Array
    held_out_fit_N: Array
    used: Mask
    held_out: Mask
    block: Index
    rate: float

    @property
    def residual_before(self) -> Array:
        """Measured minus simulated by the machine as it is [N]."""
        return self.friction_N - self.nominal_N

    @property
    def residual_after(self) -> Array:
        """Measured minus simulated by the extended model [N], of the fit that did not see the held-out segments."""
        return self.friction_N - self.held_out_fit_N
