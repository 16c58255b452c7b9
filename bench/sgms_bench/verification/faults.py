"""Faults written by hand into emitted C, each dangerous on its own; the self-test of a package has to notice them."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Fault:
    """A change of one place of a package.

    Attributes:
        what: it does.
        file: where, behind the machine's name and an underline; `.c` for the source, a runtime header by its own name.
        code: text there, once; NAME stands for the machine's name in capitals, `name` in angle brackets for it.
        wrong: text in its place.
    """

    what: str
    file: str
    code: str
    wrong: str

    def spoil(self, files: dict[str, str], name: str) -> dict[str, str]:
        """Return the files of the package of a machine with this fault.

        Raises:
            ValueError: the text is not in the file once.
        """
        file = self.file if self.file.startswith("sgms_") else f"{name}{self.file}"
        old, new = (text.replace("NAME", name.upper()).replace("<name>", name) for text in (self.code, self.wrong))
        if files[file].count(old) != 1:
            raise ValueError(f"{self.what}: in {file} {files[file].count(old)} times: {old}")
        return {**files, file: files[file].replace(old, new)}


C, AHEAD, CONFIG = ".c", "_compensation.h", "_config.h"

FAULTS: Final = (
    Fault("sign of the force", AHEAD, "gain * friction_ahead(self)", "gain * -friction_ahead(self)"),
    Fault("force a tenth too large", AHEAD, "gain * friction_ahead(self)", "gain * 1.1 * friction_ahead(self)"),
    Fault("no limit of the force", AHEAD, "    force = sgms_fmin(sgms_fmax(force, -LIMIT), LIMIT);\n", ""),
    Fault("limit of one side alone", AHEAD, "sgms_fmin(sgms_fmax(force, -LIMIT), LIMIT)", "sgms_fmin(force, LIMIT)"),
    Fault("limit twice too high", AHEAD, "#define LIMIT 48.96", "#define LIMIT 97.92"),
    Fault("force not carried over the lag", AHEAD, "c.distance[0] = self->compensation.lag;", "c.distance[0] = 0.0;"),
    Fault("set-point ahead ignored", AHEAD, "self->compensation.ahead_given ? self->compensation.ahead[0]", "0 ? 0.0"),
    Fault("force on after it was turned off", AHEAD, "const bool on = self->compensation.on && !", "const bool on = !"),
    Fault(
        "force on where the axis is lost",
        AHEAD,
        "self->compensation.on && !is_unsound(self, speed)",
        "self->compensation.on",
    ),
    Fault("force on over a lost interval", AHEAD, "        self->interval.lost || self->chain", "        self->chain"),
    Fault("force on without a position", AHEAD, " || self->chain.counts[1] > SETTLE", ""),
    Fault("force on at impossible speed", AHEAD, "speed > 2.0 * MAX_VELOCITY", "speed > 1e9"),
    Fault(
        "position that is none accepted",
        "sgms_filter.h",
        "return sgms_fabs(p) < SGMS_FARTHEST;",
        "return !(sgms_fabs(p) >= SGMS_FARTHEST);",
    ),
    Fault("position too far accepted", "sgms_filter.h", "return sgms_fabs(p) < SGMS_FARTHEST;", "return p - p == 0.0;"),
    Fault(
        "force that is none accepted",
        "sgms_filter.h",
        "return sgms_fabs(x) < SGMS_LARGEST_SIGNAL; /* false for NaN */",
        "return !(sgms_fabs(x) >= SGMS_LARGEST_SIGNAL);",
    ),
    Fault(
        "gap not bridged",
        "sgms_filter.h",
        "*position = sgms_position_ahead(m->position[0], m->position[1]);",
        "*position = m->position[0];",
    ),
    Fault(
        "measurements valid while filters settle",
        "sgms_filter.h",
        "m->counts[1] == 0 && m->counts[2] >= chain->settle",
        "m->counts[1] == 0",
    ),
    Fault(
        "measurements valid in a gap",
        "sgms_filter.h",
        "m->counts[0] == 3 && *error <= SGMS_MOST_BRIDGED",
        "m->counts[0] == 3",
    ),
    Fault("bridged samples count as measured", "sgms_filter.h", "+ *error * *error)", ")"),
    Fault(
        "impulse over a gap lost",
        "sgms_filter.h",
        "*force += (*force - before) * (SGMS_R(0.5) * (sgms_real)m->counts[3]);",
        "*force += SGMS_R(0.0) * before;",
    ),
    Fault(
        "gap crossed at constant speed",
        "sgms_filter.h",
        "m->position[1], sgms_position_from(m->last[4] / chain->rate));",
        "m->position[1], sgms_position_from(SGMS_R(0.0)));",
    ),
    Fault(
        "sign of the inertial force",
        "sgms_filter.h",
        "m->last[2] - m->mass * acceleration;",
        "m->last[2] + m->mass * acceleration;",
    ),
    Fault(
        "mass ignored",
        "sgms_filter.h",
        "m->last[2] - m->mass * acceleration;",
        "m->last[2] - SGMS_R(20.0) * acceleration;",
    ),
    Fault(
        "velocity of one sample earlier",
        "sgms_filter.h",
        "    m->last[1] = velocity;\n",
        "    m->last[1] = out.velocity;\n",
    ),
    Fault("any mass taken", C, "if (!(moved >= MASS / MASS_RANGE && moved <= MASS * MASS_RANGE)) {", "if (0) {"),
    Fault("checksum ignored", C, " && saved->checksum == checksum_of(saved);", ";"),
    Fault("checksum over less", C, "i < sizeof *saved; i++", "i < sizeof *saved - 200u; i++"),
    Fault("another machine's data taken", C, "saved->machine[1] == NAME_SAVED_MACHINE_1;", "saved->machine[1] != 0u;"),
    Fault("saved parameters not taken", C, "    copy(self->estimate.theta, saved->theta, PARAMETERS);\n", ""),
    Fault("pause forgotten", C, "pause[p] * pause[p] + (spread", "0.0 * pause[p] + (spread"),
    Fault(
        "deviations ten times too small",
        C,
        "sgms_sqrt(variance[p] * self->estimate.spread[p]) * parameter_unit[p]",
        "0.1 * sgms_sqrt(variance[p] * self->estimate.spread[p]) * parameter_unit[p]",
    ),
    Fault(
        "status always good",
        C,
        "        estimate->status = (int)self->estimate.status;\n",
        "        estimate->status = 0;\n",
    ),
    Fault(
        "status of a missing measurement left out", C, "status += self->interval.valid < 1.0 ? NAME_MISSING : 0;", ";"
    ),
    Fault(
        "status of a bound left out", C, "solve_theta(self, theta) > 0 ? NAME_BOUND : 0", "solve_theta(self, theta) * 0"
    ),
    Fault("status of lost samples left out", C, "self->interval.lost || !is_counted ?", "!is_counted ?"),
    Fault("status of speed left out", C, "status += self->interval.too_fast ? NAME_SPEED : 0;", ";"),
    Fault("status of standstill left out", C, "status += moves ? 0 : NAME_HOLD;", ";"),
    Fault(
        "doubt never said",
        C,
        "    return self->innovations.ratio_fast > DOUBTED_FAST ||",
        "    return 0 && self->innovations.ratio_fast > DOUBTED_FAST ||",
    ),
    Fault("estimate never stale", C, "estimate->age > 2u * SAMPLES", "estimate->age > 200u * SAMPLES"),
    Fault("age not set back", C, "    self->calls.age = 0;\n\n", "\n"),
    Fault("updates not counted", C, "    self->estimate.update++;\n", ""),
    Fault("solution that is no number taken", C, "    if (numeric != 0) {\n", "    if (0) {\n"),
    Fault("cause of no solution lost", C, "    self->estimate.numeric = numeric;\n", ""),
    Fault(
        "bounds ignored",
        "sgms_linalg.h",
        "    if (active == 0) {\n        return 0;",
        "    if (active >= 0) {\n        return active;",
    ),
    Fault("feedback inside of prepare", C, "    if (phase != IDLE && phase != INVALID) {\n", "    if (0) {\n"),
    Fault(
        "feedback before its time",
        C,
        "    if (!is_complete(self)) {\n        return NAME_EARLY;",
        "    if (0) {\n        return NAME_EARLY;",
    ),
    Fault(
        "torn estimate handed out",
        C,
        "if (version % 2u == 0u && version == self->calls.version) {\n            return;",
        "if (1) {\n            return;",
    ),
    Fault(
        "torn data saved",
        C,
        "if (version % 2u == 0u && version == self->calls.version) {\n            saved",
        "if (1) {\n            saved",
    ),
    Fault(
        "held parameter learns",
        C,
        "self->estimate.held[p] ? HELD_SD : self->settings.parameter[p]",
        "self->settings.parameter[p]",
    ),
    Fault(
        "number that is none set", C, "!(sd == 0.0 || (sd >= HELD_SD && is_size(sd))) || !are_moderate(&theta, 1)", "0"
    ),
    Fault(
        "parameter beyond its bounds set", C, "if (theta < lower - HELD_SD || theta > upper + HELD_SD) {", "if (0) {"
    ),
    Fault("settings not checked", C, "    if (!are_valid(settings)) {\n", "    if (0) {\n"),
    Fault(
        "reset forgets what was learned",
        C,
        "    start_signals(self);\n    copy(self->parameters.theta, self->estimate.theta, PARAMETERS);\n",
        "    start_signals(self);\n    fill(self->parameters.theta, 1.0, PARAMETERS);\n",
    ),
    Fault("damaged settings used", C, "if (sum_of(&self->settings) != self->settings_sum) {", "if (0) {"),
    Fault("damaged means of lasting errors kept", C, "if (sum_of_lasting(self) != self->lasting.sum) {", "if (0) {"),
    Fault("interval of too few samples not told", C, "self->interval.lost || !is_counted ?", "self->interval.lost ?"),
    Fault("delay of signals not checked", C, "const bool good = is_timely && sgms", "const bool good = sgms"),
    Fault(
        "invalid friction taken",
        C,
        "signals->valid > 0.0 && sgms_is_reading(signals->friction)\n        ? sgms_fmin(signals->valid, 1.0)",
        "sgms_is_reading(signals->friction)\n        ? 1.0",
    ),
    Fault("another header accepted", C, " || header != NAME_HEADER) {", ") {"),
    Fault("another size accepted", C, "if (size != sizeof(<name>_t) || header", "if (header"),
    Fault("calls of an axis that may not compute", C, "calls.mark == NAME_HEADER", "calls.mark != 0u"),
    Fault("parameters' noise wrong", CONFIG, "prior_sd[PARAMETERS] = {0.4,", "prior_sd[PARAMETERS] = {0.5,"),
    Fault("measurement noise wrong", CONFIG, "#define MEASUREMENT_SD 0.1 ", "#define MEASUREMENT_SD 0.2 "),
    Fault("wild measurements count as others", CONFIG, "#define RATIO_FREE 9.0", "#define RATIO_FREE 9e9"),
    Fault(
        "measurements inside intervals twice", C, "    self->inner.folded = j + 1;\n", "    self->inner.folded = j;\n"
    ),
    Fault(
        "window one interval short",
        C,
        "const bool is_full = older_intervals(self) == HORIZON - 1;",
        "const bool is_full = older_intervals(self) == HORIZON - 2;",
    ),
    Fault(
        "arrival cost without its information",
        C,
        "self->sweep.start + slot_before(self, back - 1) * TRIANGLE_SIZE",
        "self->sweep.start + slot_before(self, back) * TRIANGLE_SIZE",
    ),
    Fault("a number of another sign than itself", "sgms_math.h", "^ sgms_bits(b)) >= 0", "^ sgms_bits(b)) > 0"),
    Fault("a term of 2^x left out", "sgms_math.h", "    p = p * f + 1.5309737294734561e-5;\n", ""),
    Fault(
        "terms of the flow ahead in the other order",
        "_flow.h",
        "value = value * t + c[6];\n    value = value * t + c[5];",
        "value = value * t + c[5];\n    value = value * t + c[6];",
    ),
)
"""Of `etel_xy`; all of them compile."""
