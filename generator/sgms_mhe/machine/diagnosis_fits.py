"""`[diagnosis]`, the first half: which rows of a record count, and how models are fitted to them."""

from __future__ import annotations

from typing import Any, Final, Self

from pydantic import model_validator

from sgms_mhe.machine.fields import Table, quantity, refusal

ORDERED: Final = (
    ("rate_min", "rate_max"),
    ("block_min", "block_max"),
    ("lead_min", "lead_max"),
    ("rest_speed", "slow_speed"),
    ("settled_step", "search_step"),
    ("iterations", "patient_iterations"),
)
"""Pairs of which the first is not larger than the second."""


def threshold(default: float, unit: str, meaning: str, why: str, **limits: float) -> Any:
    """A number; `unit`: what it counts in; `why`: the reason for its default, or for the threshold."""
    return quantity(f"{meaning} ({why})", unit, default, **limits)


class FitThresholds(Table):
    """What a record must hold, and how models are fitted to it."""

    # --- which rows of a record count -----------------------------------------------------------------------------

    rate_max: float = threshold(
        1000.0, "Hz", "rows of a fit per second, at most", "friction has nothing to say above it", gt=0, le=1e6
    )
    rate_min: float = threshold(
        200.0,
        "Hz",
        "rows of a fit per second, at least; otherwise twice the velocity cutoff",
        "reversals still show behind a slow filter",
        gt=0,
        le=1e6,
    )
    rows_max: int = threshold(
        150_000,
        "1",
        "rows of a record; a longer one has coarser rows",
        "bounds the memory of derivatives",
        ge=1000,
        le=10_000_000,
    )
    rows_min: int = threshold(
        100,
        "1",
        "rows that a record must have, and as many that count",
        "blocks of a shorter one hold next to nothing",
        ge=20,
        le=1_000_000,
    )
    blocks: int = threshold(
        48,
        "1",
        "blocks that a record is cut into, the independent units of all tests",
        "enough for tests of several numbers",
        ge=8,
        le=1000,
    )
    block_min: float = threshold(
        0.1, "s", "shortest block", "what a model gets wrong at a reversal is over within it", gt=0, le=100
    )
    block_max: float = threshold(
        2.0, "s", "longest block", "a long record gives more units, not longer ones", gt=0, le=1000
    )
    block_rows_min: int = threshold(5, "1", "rows that count in a block, at least", "fewer are no unit", ge=1, le=1000)
    block_used_min: float = threshold(
        0.2,
        "block",
        "share of its rows that count in a block, at least",
        "a block that is mostly gap is no unit",
        ge=0,
        le=1,
    )
    folds: int = threshold(
        5, "1", "folds of a cross-validation", "each fit sees four fifths: nearly what a fit of all sees", ge=2, le=50
    )
    held_out_one_in: int = threshold(
        3, "blocks", "of so many blocks one is held out", "a third judges, two thirds fit", ge=2, le=20
    )
    forget: float = threshold(
        4.0,
        "deflection scales",
        "extent of a motion after which elements do not remember where they started",
        "all of them slip by then",
        gt=0,
        le=100,
    )
    remembered_min: float = threshold(
        0.5,
        "good samples",
        "share that must stay where samples are left out at which a gap makes states unknown",
        "presliding alone never forgets; it is kept, and taken to start from relaxed elements",
        ge=0,
        le=1,
    )
    saturated_run: int = threshold(
        5,
        "samples",
        "run of exactly the largest force that is a saturation",
        "noise does not repeat a number so often",
        ge=2,
        le=1000,
    )
    noise_rows: int = threshold(
        16,
        "rows",
        "stretch that a model's errors are smooth over: what a parabola leaves there is noise",
        "they are, but where the axis is fast; the quieter half decides",
        ge=6,
        le=1000,
    )
    excited: float = threshold(
        0.05,
        "f_C",
        "range of the simulated friction below which a record says nothing of it",
        "the axis hardly moves",
        gt=0,
        le=2,
    )

    moving_way: float = threshold(
        0.1,
        "smallest deflection scale",
        "way within moving_time from which the axis moves, for what excites an effect",
        "less is rest and noise",
        gt=0,
        le=100,
    )
    moving_time: float = threshold(
        0.01, "s", "time that the way of moving_way is covered in", "averages the noise of the position", gt=0, le=10
    )

    # --- pieces of a long record ----------------------------------------------------------------------------------

    fitted_time: float = threshold(
        60.0,
        "s",
        "part of a record that models are fitted to; of a longer one pieces from all over it",
        "bounds the work; what is left is stated for all of the record",
        ge=5,
        le=1e6,
    )
    lead_min: float = threshold(0.5, "s", "motion before a piece, at least", "what only time settles", gt=0, le=100)
    lead_max: float = threshold(
        2.0, "s", "motion before a piece, at most", "it is run through and says nothing", gt=0, le=1000
    )
    lead_travel: float = threshold(
        0.3,
        "range of position",
        "way of the motion before a piece, within lead_min and lead_max",
        "slow hysteresis is known after it",
        ge=0,
        le=10,
    )
    slow_speed: float = threshold(
        0.02,
        "largest speed",
        "speed below which motion counts as slow where pieces are chosen",
        "pieces rich in slow motion are wanted too",
        gt=0,
        lt=1,
    )
    rest_speed: float = threshold(
        4e-4,
        "largest speed",
        "speed below which the axis rests where pieces are chosen",
        "reversals count from rest too",
        gt=0,
        lt=1,
    )
    places: int = threshold(
        60,
        "1",
        "parts of the range of position that pieces are to have been at",
        "pitches show over all of it",
        ge=2,
        le=10_000,
    )

    # --- fits -----------------------------------------------------------------------------------------------------

    search_rate: float = threshold(
        1000.0,
        "Hz",
        "steps of a search per second, at least, as many samples sharing one as that allows",
        "the rate of the rows; alignment takes out what a longer step changes",
        gt=0,
        le=1e6,
    )
    iterations: int = threshold(
        12, "1", "steps of a fit, at most", "it starts from a proposal, near its end", ge=1, le=1000
    )
    patient_iterations: int = threshold(
        40,
        "1",
        "steps of a fit, at most, where all of the machine's numbers may have far to go",
        "what is left then moves all of them",
        ge=1,
        le=1000,
    )
    search_step: float = threshold(
        10.0, "rows' worth of noise", "what a step of a search must promise", "less decides nothing", ge=0, le=1e6
    )
    settled_step: float = threshold(
        0.01,
        "rows' worth of noise",
        "what a step must promise where numbers are reported",
        "a tenth of a standard deviation",
        ge=0,
        le=1e6,
    )
    machine_prior: float = threshold(
        1.0,
        "nominal value",
        "prior of the machine's numbers, 1 sigma",
        "holds what the record does not excite",
        gt=0,
        le=1e6,
    )
    effect_prior: float = threshold(
        10.0,
        "nominal value",
        "prior of an effect's numbers in a step, 1 sigma",
        "it damps the step and says nothing of a size",
        gt=0,
        le=1e9,
    )
    machine_step: float = threshold(
        0.5,
        "nominal or present value",
        "change of the machine's numbers in a step, at most",
        "derivatives hold no farther",
        gt=0,
        le=10,
    )
    unstable: float = threshold(
        1e6,
        "largest friction",
        "derivative from which no integration step was short enough",
        "a state that diverges shows in its derivatives first",
        gt=1,
    )
    timing: float = threshold(
        0.1,
        "sample",
        "time that force and position may be apart without that being a delay",
        "no two signals are sampled at quite the same instant",
        gt=0,
        le=1,
    )
    timing_most: float = threshold(
        0.6,
        "sample",
        "delay up to which it is the sampling's and not the axis's",
        "a force that is held over a sample is half a sample old on average; and a margin",
        ge=0,
        le=2,
    )
    alignable: float = threshold(
        0.1,
        "friction",
        "change of friction by a longer step that alignment takes out, standard deviations",
        "a model that it changes more is fitted at the full rate",
        gt=0,
        le=1,
    )
    coherent_rows: int = threshold(
        16, "rows", "stretch that a model's own error keeps its sign over, for intervals", "a reversal", ge=1, le=10_000
    )
    unseen: float = threshold(
        0.15,
        "noise floor",
        "RMS that a model may get wrong beyond what is seen, for intervals",
        "a floor that is right to 1 % hides as much",
        ge=0,
        le=1,
    )

    # --- the law: sticking and slipping ---------------------------------------------------------------------------

    sharp_zeta: float = threshold(
        0.985,
        "1",
        "zeta of elements that slip almost at once, for effects that do not stand with switching ones",
        "with 0.995 derivatives outgrow the steps of a fit",
        gt=0,
        lt=1,
    )
    sharp_lambda: float = threshold(
        233.0,
        "1",
        "lambda of elements that slip almost at once",
        "lambda (1 - zeta) = 3.5, as with the default smoothing",
        gt=0,
        le=1e6,
    )
    sharp_gamma: float = threshold(233.0, "1", "gamma of elements that slip almost at once", "as lambda", gt=0, le=1e6)
    sharper: float = threshold(
        0.97,
        "RMS left by the other",
        "RMS below which the law is taken that is not the machine file's",
        "of a smaller difference the machine file is right",
        gt=0,
        le=1,
    )
    surer: float = threshold(
        3.0,
        "1",
        "t over blocks from which the law is taken that leaves less, though hardly",
        "near the noise little is left to leave",
        gt=0,
        le=100,
    )
    decided: float = threshold(
        0.8,
        "RMS left by the other",
        "RMS below which a law is the axis's, and the other is not tried again",
        "no effect turns so much round",
        gt=0,
        le=1,
    )
    decided_left: float = threshold(
        2.0,
        "gain that matters",
        "RMS beyond noise up to which a law is decided",
        "with more left something large is still missing",
        ge=0,
        le=1e3,
    )
    alignments: int = threshold(
        2, "1", "alignments of a model at a selection, each with a fit", "to the second order", ge=1, le=20
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        for low, high in ORDERED:
            if getattr(self, low) > getattr(self, high):
                raise refusal(low, getattr(self, low), f"at most {high} = {getattr(self, high):g}")
        return self
