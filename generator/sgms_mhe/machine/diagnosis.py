"""`[diagnosis]`: a user's thresholds for a diagnosis, and how much work it may do.

All other thresholds are constants beside the code that uses them. Defaults and constants were tuned on draws of
`sgms-mhe bench-diagnosis` (simulated axes with hidden causes) and tried on measured records. Where a right name weighs
against a wrong one they lean towards none.
"""

from typing import ClassVar

from sgms_mhe.machine.fields import MachineTable, quantity


class DiagnosisTable(MachineTable):
    """Choices of a diagnosis. They change neither the emitted C nor the digest of a machine."""

    unknown: ClassVar[str] = "unknown key, or a threshold that is a constant of the diagnosis since 0.2"

    @property
    def changed(self) -> dict[str, float]:
        """Values that are not the defaults."""
        return self.model_dump(exclude_defaults=True)

    significance: float = quantity(
        "p value of a candidate, its trials and all candidates counted (every log is searched for everything)",
        "1",
        1e-3,
        gt=0,
        lt=1,
    )
    material: float = quantity(
        "RMS gain that matters, and at least a quarter of the noise floor (less is no cause but a detail)",
        "f_C",
        0.004,
        gt=0,
        le=1,
    )
    unexplained: float = quantity(
        "RMS beyond noise that a complete explanation may leave (laws of friction differ by as much at reversals)",
        "f_C",
        0.02,
        gt=0,
        le=1,
    )
    rounds: int = quantity(
        "steps of the forward selection, each of which adds an effect (bounds the work)", "1", 5, ge=1, le=50
    )
    refits: int = quantity(
        "candidates that are refitted in a step or in a cause's place (bounds the work)", "1", 4, ge=1, le=100
    )
    finest_pitch: float = quantity(
        "wavenumber up to which ripples are searched, rounded up to an octave (finer than what encoders and motors are "
        "built with)",
        "1 / longest pitch",
        1500.0,
        ge=2,
        le=1e6,
    )
    fitted_time: float = quantity(
        "part of a record that models are fitted to, segments from all over a longer one (bounds the work; the "
        "residual is stated for all of the record)",
        "s",
        60.0,
        ge=5,
        le=1e6,
    )
    folds: int = quantity(
        "folds of the cross-validation (each fit sees four fifths: nearly what a fit of all sees)", "1", 5, ge=2, le=50
    )
    held_out_one_in: int = quantity(
        "one of so many blocks is held out (a third judges, two thirds fit)", "blocks", 3, ge=2, le=20
    )
