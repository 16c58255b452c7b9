"""Axes that others wrote: joints of MuJoCo and servo models of better-actuator-models, in closed loop.

Nothing of this project computes their motion. Each is driven by a PD controller, its log has an encoder's steps and a
noisy torque; `identify` makes the machine file of that log alone, `diagnose` judges it on a second one, and the emitted
C, called through its Python binding, feeds the friction forward to the same plant on a third motion.
"""

import importlib.util
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

import sgms_mhe
from sgms_bench.studies.cases import done_of
from sgms_mhe.machine import Machine
from sgms_mhe.support.processes import HERE, Task, WorkerSlot, results
from sgms_mhe.support.tables import CsvTable

Array = NDArray[np.float64]

RATE: Final = 500.0
"""Samples per second [Hz]."""
STEP: Final = 2.0 * math.pi / 2**14
"""Of the encoder [rad]."""
NOISE: Final = 0.003
"""Of the torque, over its RMS."""
BANDWIDTH: Final = 2.0 * math.pi * 4.0
"""Of the position loop [rad/s]."""
SETTLED: Final = 0.2
"""Share of a run after which tracking counts."""


class DrivenJoint(Protocol):
    """A joint that turns under a torque.

    Attributes:
        inertia: of all that moves [kg m^2].
        gravity: torque at a quarter turn from hanging [N m].
        angle: from hanging [rad].
    """

    inertia: float
    gravity: float

    @property
    def angle(self) -> float:
        """Of the joint [rad]."""

    def start(self, angle: float) -> None:
        """Stand at an angle [rad]."""

    def turn(self, torque: float) -> None:
        """Go on for one sample under a torque [N m]."""


# --- MuJoCo -----------------------------------------------------------------------------------------------------

ARM: Final = """
<mujoco>
  <option timestep="0.00025" integrator="implicitfast"/>
  <worldbody>
    <body>
      <joint name="joint" type="hinge" axis="0 1 0" armature="{armature}" damping="{damping}" frictionloss="{loss}"/>
      <inertial pos="0 0 -{length}" mass="{mass}" diaginertia="{own} {own} {own}"/>
    </body>
  </worldbody>
  <actuator><motor joint="joint"/></actuator>
</mujoco>
"""


class MujocoJoint:
    """A hinge of MuJoCo with damping and frictionloss that carries a load; see `DrivenJoint`.

    Args:
        mass: of the load [kg].
        length: of its arm [m].
        armature: inertia of the rotor [kg m^2].
        damping: [N m s/rad].
        loss: level of sliding friction [N m].
    """

    def __init__(self, mass: float, length: float, armature: float, damping: float, loss: float) -> None:
        mujoco: Any = import_module("mujoco")
        own = 0.1 * mass * length**2
        text = ARM.format(mass=mass, length=length, armature=armature, damping=damping, loss=loss, own=own)
        self._mujoco, self._model = mujoco, mujoco.MjModel.from_xml_string(text)
        self._data = mujoco.MjData(self._model)
        self._substeps = round(1.0 / RATE / self._model.opt.timestep)
        self.inertia = mass * length**2 + own + armature
        self.gravity = mass * length * float(-self._model.opt.gravity[2])

    @property
    def angle(self) -> float:
        """Of the joint [rad]."""
        return float(self._data.qpos[0])

    def start(self, angle: float) -> None:
        """Stand at an angle [rad]."""
        self._mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[0] = angle

    def turn(self, torque: float) -> None:
        """Go on for one sample under a torque [N m]."""
        self._data.ctrl[0] = torque
        self._mujoco.mj_step(self._model, self._data, self._substeps)


# --- better-actuator-models -------------------------------------------------------------------------------------

LOADS: Final[Mapping[str, tuple[float, float, float, float]]] = {
    "mx106": (0.8, 0.1, 0.15, 15.0),
    "mx64": (0.5, 0.08, 0.15, 15.0),
    "xl320": (0.06, 0.02, 0.1, 7.5),
    "xl330": (0.08, 0.02, 0.1, 7.5),
    "erob80_50": (3.0, 0.5, 0.4, 48.0),
    "erob80_100": (6.0, 0.5, 0.5, 48.0),
}
"""Of each motor's pendulum: mass [kg], that of its arm [kg], its length [m], supply [V]."""
VARIANTS: Final = ("m1", "m2", "m3", "m4", "m5", "m6")
"""Friction models, from Coulomb and viscous to Stribeck and load with a quadratic share."""
SUBSTEPS: Final = 8


class ServoJoint:
    """A pendulum on a motor of better-actuator-models, with one of its friction models; see `DrivenJoint`.

    Friction is what stops the motor in a step of the integration, up to the model's level, as its authors have it.
    """

    def __init__(self, motor: str, variant: str) -> None:
        load_model: Any = import_module("bam.model").load_model
        mass, arm, length, supply = LOADS[motor]
        self._model = load_model(motor_name=motor, model=variant)
        self._model.q_offset.value = 0.0
        log = {"mass": mass, "arm_mass": arm, "length": length, "kp": 32.0, "vin": supply}
        self._model.actuator.load_log(log)
        self._load = self._model.actuator.testbench
        self.inertia = float(self._load.compute_mass(0, 0) + self._model.actuator.get_extra_inertia())
        self.gravity = float(-self._load.compute_bias(0.5 * math.pi, 0.0))
        self._angle = self._speed = 0.0

    @property
    def angle(self) -> float:
        """Of the motor's shaft [rad]."""
        return self._angle

    def start(self, angle: float) -> None:
        """Stand at an angle [rad]."""
        self._angle, self._speed = angle, 0.0

    def turn(self, torque: float) -> None:
        """Go on for one sample under a torque [N m]."""
        step = 1.0 / RATE / SUBSTEPS
        for _ in range(SUBSTEPS):
            carried = float(self._load.compute_bias(self._angle, self._speed))
            loss, damping = self._model.compute_frictions(torque, carried, self._speed)
            stopping = self.inertia / step * self._speed + torque + carried
            friction = math.copysign(min(abs(stopping), loss + damping * abs(self._speed)), stopping)
            self._speed += (torque + carried - friction) / self.inertia * step
            self._angle += self._speed * step


AXES: Final[Mapping[str, Callable[[], DrivenJoint]]] = {
    "MuJoCo arm": partial(MujocoJoint, 2.0, 0.3, 0.02, 0.3, 1.0),
    "MuJoCo wheel": partial(MujocoJoint, 0.5, 0.01, 0.05, 0.05, 0.3),
    "MuJoCo finger": partial(MujocoJoint, 0.05, 0.06, 2e-4, 2e-3, 0.01),
    **{f"{motor} {variant}": partial(ServoJoint, motor, variant) for motor in LOADS for variant in VARIANTS},
}
"""Joints by name; servos need better-actuator-models."""


# --- loop -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SetPoint:
    """A set-point (n) and its derivatives: angle [rad], speed [rad/s], acceleration [rad/s^2]."""

    angle: Array
    speed: Array
    acceleration: Array


def drawn_motion(seed: int, seconds: float) -> SetPoint:
    """Return a sum of six sines of 0.1 to 1.6 Hz within 1.2 to 2.2 rad of hanging."""
    random = np.random.default_rng([7, seed])
    time = np.arange(int(seconds * RATE)) / RATE
    pace = 2.0 * math.pi * random.uniform(0.1, 1.6, 6)
    size = random.uniform(0.3, 1.0, 6) / (1.0 + pace / (2.0 * math.pi))
    turns = np.outer(time, pace) + random.uniform(0.0, 2.0 * math.pi, 6)
    largest = float(np.abs(np.sin(turns) @ size).max())
    size *= float(random.uniform(1.2, 2.2)) / largest
    return SetPoint(np.sin(turns) @ size, np.cos(turns) @ (size * pace), -np.sin(turns) @ (size * pace**2))


@dataclass(frozen=True)
class JointRun:
    """A joint along a motion: encoder's angle (n) [rad], torque as logged (n) [N m], set-point less angle (n) [rad]."""

    angle: Array
    torque: Array
    error: Array

    @property
    def log(self) -> dict[str, Array]:
        """Columns for `identify` and `diagnose`."""
        return {"time_s": np.arange(len(self.angle)) / RATE, "position_rad": self.angle, "torque_Nm": self.torque}

    @property
    def tracking(self) -> float:
        """RMS of the error once it has settled [rad]."""
        return float(np.sqrt(np.mean(self.error[int(SETTLED * len(self.error)) :] ** 2)))


Feed = Callable[[int, float, float], float]
"""Torque fed forward from now on [N m], of (sample, encoder's angle, torque before)."""


def add_noise(run: JointRun, noise: float, seed: int) -> JointRun:
    """Return a run whose logged torque has noise of a standard deviation [N m]; the drive does not know of it."""
    return replace(run, torque=run.torque + noise * np.random.default_rng([8, seed]).standard_normal(len(run.torque)))


def drive_joint(joint: DrivenJoint, motion: SetPoint, feed: Feed | None = None) -> JointRun:
    """Drive a joint along a motion by PD and its inertia's torque.

    Args:
        joint: starts anew.
        motion: set-point.
        feed: torque fed forward beside that; None: none.
    """
    n = len(motion.angle)
    angle, torque, error = np.empty(n), np.empty(n), np.empty(n)
    stiff, damping = joint.inertia * BANDWIDTH**2 + 2.0 * joint.gravity, 1.4 * joint.inertia * BANDWIDTH
    joint.start(float(motion.angle[0]))
    before, drive = float(motion.angle[0]), 0.0
    for k in range(n):
        error[k] = motion.angle[k] - joint.angle
        angle[k] = round(joint.angle / STEP) * STEP
        speed, before = (angle[k] - before) * RATE, angle[k]
        fed = 0.0 if feed is None else feed(k, float(angle[k]), drive)
        drive = stiff * (motion.angle[k] - angle[k]) + damping * (motion.speed[k] - speed)
        drive += joint.inertia * motion.acceleration[k] + fed
        torque[k] = drive
        joint.turn(drive)
    return JointRun(angle, torque, error)


# --- study ------------------------------------------------------------------------------------------------------


def fit_static_feed(run: JointRun, motion: SetPoint) -> Feed:
    """Torque of gravity, Coulomb and viscous friction by least squares of a run, along another set-point."""

    def columns(angle: Array, speed: Array) -> Array:
        return np.column_stack((np.sin(angle), np.cos(angle), np.sign(speed), speed))

    speed = np.gradient(run.angle) * RATE
    acceleration = np.gradient(speed) * RATE
    X = np.column_stack((columns(run.angle, speed), acceleration))
    numbers = np.linalg.lstsq(X, run.torque)[0][:4]
    torque = columns(motion.angle, motion.speed) @ numbers
    return lambda k, angle, drive: float(torque[k])


def call_emitted_c(machine: Machine, folder: Path, motion: SetPoint) -> Feed:
    """Have the emitted C of a machine say what to feed forward, sample by sample, through its Python binding."""
    sgms_mhe.generate(machine, folder, bindings="python")
    estimator = _module(folder / f"{machine.name}.py").Estimator()

    def answer(k: int, angle: float, drive: float) -> float:
        estimator.ahead(float(motion.speed[k]), float(motion.acceleration[k]))
        return float(estimator.sample(angle, drive))

    return answer


def _module(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise ValueError(f"{path}: no module")
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


def joint_row(name: str, seconds: float, seed: int) -> dict[str, Any]:
    """One row of the study: what identification finds, what diagnosis says, how well the joint tracks."""
    joint = AXES[name]()
    motions = [drawn_motion(3 * seed + k, seconds) for k in range(3)]
    first, second, bare = (drive_joint(joint, motion) for motion in motions)
    noise = NOISE * float(np.std(first.torque))
    first, second = add_noise(first, noise, seed), add_noise(second, noise, seed + 1)
    row: dict[str, Any] = {"joint": name}
    static = fit_static_feed(first, motions[2])
    row["PD"] = 1e3 * bare.tracking
    row["static"] = 1e3 * drive_joint(joint, motions[2], static).tracking
    try:
        found = sgms_mhe.identify(first.log, name="joint", note=lambda sentence: None)
    except sgms_mhe.InputError as error:
        return row | {"verdict": f"refused: {error.where}"}
    numbers = {number.name: number.value for number in found.numbers}
    gravity = numbers.get("unbalance.amplitude_N", math.nan)
    row["inertia"] = 100.0 * (numbers["mass"] / joint.inertia - 1.0)
    row["gravity"] = 100.0 * (gravity / joint.gravity - 1.0)
    row["floors"] = found.held_out_rms_N / found.noise_floor_N
    judged = sgms_mhe.diagnose(found.machine, second.log, note=lambda sentence: None)
    row["verdict"] = " ".join([judged.verdict, *(cause.name for cause in judged.causes)])
    row["left"] = 100.0 * judged.errors["after"]
    with TemporaryDirectory() as folder:
        feed = call_emitted_c(found.machine, Path(folder), motions[2])
        row["C"] = 1e3 * drive_joint(joint, motions[2], feed).tracking
    return row


def others_study(joints: int, seconds: float, place: WorkerSlot = HERE) -> CsvTable:
    """Joints of MuJoCo and of better-actuator-models: identified, judged on a second log, compensated by the C.

    Args:
        joints: of `AXES`, the first ones; servos only where their package is installed.
        seconds: of each of a joint's three motions.
        place: where they run.
    """
    has_servos = find_spec("bam") is not None
    names = [name for name in AXES if has_servos or name.startswith("MuJoCo")][:joints]
    rows = results([Task(name, joint_row, (name, seconds, 1)) for name in names], place, done_of("joints"))
    formats = {"joint": "", "inertia": "+.1f", "gravity": "+.1f", "floors": ".2f", "left": ".1f", "verdict": ""}
    absent = () if has_servos else ("servos: pip install better-actuator-models, which takes Python 3.12;",)
    return CsvTable(
        f"joints that others wrote, three motions of {seconds:g} s each",
        formats | {"PD": ".2f", "static": ".2f", "C": ".2f"},
        rows,
        (
            *absent,
            "inertia, gravity: percent off; floors: residual on held-out data over the noise floor;",
            "verdict, left: of a second log, and the simulation error after it in percent of the force;",
            "PD, static, C: tracking error in mrad rms, without friction and gravity fed forward, with Coulomb and",
            "viscous friction and gravity by least squares, and with what the emitted C says",
        ),
    )
