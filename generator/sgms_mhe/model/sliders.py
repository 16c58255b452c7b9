"""Maxwell-slip elements as springs to sliders with LuGre friction, which a simulator of rigid bodies holds."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import least_squares
from scipy.special import wrightomega

from sgms_mhe.machine import Friction, Smoothing
from sgms_mhe.model.simple import SimpleAxis
from sgms_mhe.support.arrays import Array

STIFFEST: Final = 30.0
"""Stiffness of a slider's bristle over that of its spring at the most: a slider's mass grows with it."""
HEAVIEST: Final = 0.01
"""Share of the axis' inertia that the sliders have at the most."""
STEPS_PER_SWING: Final = 1.5
"""Square of steps per radian of a slider's swing, at which the swing is stable with `SLIDER_DAMPING`."""
SLIDER_DAMPING: Final = 0.6
"""Damping ratio of a slider's swing."""


@dataclass(frozen=True)
class Slider:
    """An element: a spring [N/m] to a slider [kg] whose bristle [N/m] with its damping [N s/m] slips at a level [N].

    `micro_viscous` [N s/m] acts along the spring.
    """

    stiffness: float
    bristle: float
    damping: float
    level: float
    mass: float
    micro_viscous: float


@dataclass(frozen=True, kw_only=True)
class SliderAxis(SimpleAxis):
    """An axis whose elements are sliders; the Stribeck effect is a bristle of its own [N/m] on the axis.

    `step`: of the simulator [s], for which the sliders are heavy enough.
    """

    sliders: tuple[Slider, ...]
    bristle: float
    step: float

    @property
    def carriage(self) -> float:
        """Inertia without the sliders, which move with the axis while it slides [kg, kg m^2]."""
        return self.inertia - sum(slider.mass for slider in self.sliders)

    def friction(self, velocity: Array, force: Array, step: float) -> Array:
        """Return the friction (n) along a motion, each velocity for a step; the sliders have no mass.

        Of spring K and bristle S that slips at f, w = 1 - F/f along the motion, S/K w + ln w falls by S dx / f.
        """
        stiffness, level, micro = np.array([(s.stiffness, s.level, s.micro_viscous) for s in self.sliders]).T
        bristle = np.array([s.bristle for s in self.sliders])
        ratio, rest = bristle / stiffness, self.coulomb * self.stribeck_ratio
        force_of, stribeck, friction = np.zeros(len(level)), 0.0, np.zeros(len(velocity))
        for k, v in enumerate(np.nan_to_num(velocity).tolist()):
            before, sign, travel = force_of, math.copysign(1.0, v), abs(v) * step
            ahead = np.maximum(1.0 - sign * force_of / level, 1e-300)
            ahead = wrightomega(np.log(ratio * ahead) + ratio * ahead - bristle * travel / level) / ratio
            force_of = sign * level * (1.0 - ahead)
            height = rest * math.exp(-((v / self.stribeck_velocity) ** 2)) + 1e-300
            remains = math.exp(-self.bristle * travel / height)
            stribeck = remains * stribeck + sign * height * (1.0 - remains)
            friction[k] = force_of.sum() + stribeck + micro @ ((force_of - before) / stiffness) / step
        return friction + self.viscous * velocity


def slider_axis(friction: Friction, step: float, plain: SimpleAxis) -> SliderAxis:
    """Fit sliders to a friction law.

    One stiffness and one sharpness for all elements, and the Stribeck effect's own, are such that the force along a
    reversal out of full sliding is nearest to the law's, at rest and at speed.

    Args:
        friction: the law.
        step: of the machine's samples [s]; that of the simulator is a whole part of it.
        plain: the rest of the axis.
    """
    stiffness, level = np.array(friction.stiffness), friction.coulomb * np.array(friction.fraction)
    rest = friction.coulomb * friction.stribeck_ratio
    reach = np.linspace(0.0, 4.0 * (level / stiffness).max(), 400)[:, None]
    at_rest, at_speed = (
        (high * reverse_law(friction.smoothing, stiffness * reach / high)).sum(axis=1)
        for high in (level * (1.0 + friction.stribeck_ratio), level)
    )
    level = level * reverse_law(friction.smoothing, np.array([1e3]))[0]

    def differ(logarithms: Array) -> Array:
        factor, sharpness, bristle = np.exp(logarithms)
        travel = factor * (1.0 + sharpness) * stiffness * reach / level
        force = level * (1.0 - wrightomega(np.log(2.0 * sharpness) + 2.0 * sharpness - travel) / sharpness)
        stribeck = rest * (1.0 - 2.0 * np.exp(-bristle * reach[:, 0] / (rest or 1.0)))
        return np.concatenate([force.sum(axis=1) + stribeck - at_rest, force.sum(axis=1) - at_speed])

    soft = rest / reach[-1, 0] if rest else 1.0
    bounds = np.log([[0.5, 2.0, soft], [2.0, STIFFEST, 1e4 * soft]])
    fit = least_squares(differ, np.log([1.0, 0.5 * STIFFEST, 10.0 * soft]), bounds=tuple(bounds))
    factor, sharpness, bristle = np.exp(fit.x).tolist()
    springs = factor * (1.0 + 1.0 / sharpness) * stiffness
    whole = STEPS_PER_SWING * (1.0 + sharpness) * springs
    parts = math.ceil(step * math.sqrt(whole.sum() / (HEAVIEST * plain.inertia)))
    masses = whole * (step / parts) ** 2
    sliders = tuple(
        Slider(k, sharpness * k, 2.0 * SLIDER_DAMPING * math.sqrt((1.0 + sharpness) * k * mass), high, mass, micro)
        for k, high, mass, micro in zip(
            springs.tolist(), level.tolist(), masses.tolist(), friction.micro_viscous, strict=True
        )
    )
    return SliderAxis(**vars(plain), sliders=sliders, bristle=bristle, step=step / parts)


def reverse_law(smoothing: Smoothing | None, distance: Array) -> Array:
    """Return an element's force over its level a distance after a reversal out of sliding, in level / stiffness.

    The law's direction gate is taken as open or shut: speeds well above v_s / gamma.
    """
    if smoothing is None:
        return np.clip(distance - 1.0, -1.0, 1.0)
    ratio = np.linspace(-2.0, 2.0, 8001)
    rise, fall = (np.tanh(smoothing.lambda_ * (ratio + side * smoothing.zeta)) for side in (-1.0, 1.0))
    rate = 1.0 - np.maximum(ratio, 0.0) * (1.0 + 0.5 * (rise - fall))
    top = int(np.argmax(rate < 1e-4))
    path = slice(len(ratio) - 1 - top, top)
    steps = np.diff(ratio[path]) * 0.5 * (1.0 / rate[path][1:] + 1.0 / rate[path][:-1])
    return np.interp(distance, np.concatenate([[0.0], np.cumsum(steps)]), ratio[path])
