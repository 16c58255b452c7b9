"""`[diagnosis]`: every threshold of a diagnosis, with its unit, its range and the reason for its default.

The defaults were tuned on draws of `sgms-mhe bench-diagnosis` (simulated axes with hidden causes) and tried on measured
records. Where a right name weighs against a wrong one they lean towards none.
"""

from __future__ import annotations

from sgms_mhe.machine.diagnosis_fits import FitThresholds, threshold


class Thresholds(FitThresholds):
    """What a diagnosis decides by. Nothing of it changes the emitted C, nor the digest of a machine."""

    @property
    def changed(self) -> dict[str, float]:
        """Thresholds that are not at their defaults."""
        return self.model_dump(exclude_defaults=True)

    # --- the search -----------------------------------------------------------------------------------------------

    significance: float = threshold(
        1e-3,
        "1",
        "p value of a candidate, its trials and all candidates counted",
        "every log is searched for everything",
        gt=0,
        lt=1,
    )
    start_significance: float = threshold(
        1e-3,
        "1",
        "p value of a rise of friction towards low speed that fits start from",
        "where the machine file knows of none",
        gt=0,
        lt=1,
    )
    white_floor: float = threshold(
        0.1,
        "white noise",
        "scatter of scores over blocks, at least",
        "blocks that balance by chance prove nothing",
        ge=0,
        le=1,
    )
    finest_pitch: float = threshold(
        1500.0,
        "1 / longest pitch",
        "wavenumber up to which ripples are searched, rounded up to an octave",
        "finer than what encoders and motors are built with",
        ge=2,
        le=1e6,
    )
    pitch_band: float = threshold(
        0.3,
        "rate of the rows",
        "frequency up to which a ripple is seen in passing",
        "means over a row have lost it above",
        gt=0,
        le=0.5,
    )
    cutoff_band: float = threshold(
        0.7,
        "velocity cutoff",
        "frequency up to which a ripple passes the chain's filters",
        "above, they turn its phase",
        gt=0,
        le=1,
    )
    frequency_band: float = threshold(
        0.45,
        "rate of the rows",
        "frequency up to which sines in time are searched",
        "near half the rate they are no sines any more",
        gt=0,
        le=0.5,
    )
    short_period: float = threshold(
        4.0,
        "least wavenumber",
        "wavenumber from which a sine has a short period, with a proposal of its own",
        "slow trends have more energy than they deserve",
        gt=1,
        le=1e3,
    )
    band_seen: float = threshold(
        0.2,
        "rows",
        "rows slow enough for an octave of ripples, for it to be searched",
        "a ripple that is seen hardly anywhere is told from nothing",
        ge=0,
        le=1,
    )
    edge_rows: int = threshold(
        20,
        "rows",
        "rows between a step in time and an end of the record, at least",
        "a few rows at an end are no step",
        ge=1,
        le=10_000,
    )
    edge_share: float = threshold(
        0.05,
        "rows that count",
        "rows between a step in time and an end of the record, at least",
        "what is only there at an end is a drift as well",
        gt=0,
        lt=0.5,
    )
    step_left: float = threshold(
        1e-3,
        "rows after a step",
        "what must be left of a step's column beside the free numbers",
        "of less there is nothing to fit",
        ge=0,
        lt=1,
    )
    material: float = threshold(
        0.004,
        "f_C",
        "RMS gain that matters, at least this and material_noise",
        "less is no cause but a detail",
        gt=0,
        le=1,
    )
    material_noise: float = threshold(
        0.25, "noise floor", "RMS gain that matters, at least this and material", "a smaller gain drowns", ge=0, le=10
    )
    small: float = threshold(
        0.007,
        "f_C",
        "gain from which on more than an effect explains may be left beside it, and of any wrong number",
        "a smaller one may be a part of what is left, or of what the law gets wrong",
        gt=0,
        le=1,
    )
    share: float = threshold(
        0.25,
        "RMS beyond noise",
        "gain that an effect must have to be added",
        "a small share of a lot only imitates a part of what is really there",
        ge=0,
        le=1,
    )
    left: float = threshold(
        0.2,
        "RMS beyond noise",
        "RMS gain that matters once the search has ended, at least",
        "a smaller one is not told from that",
        ge=0,
        le=1,
    )
    rounds: int = threshold(
        5, "1", "rounds of the search, each of which adds an effect", "bounds the work", ge=1, le=50
    )
    refits: int = threshold(
        4, "1", "candidates that are refitted in a round or in a place", "bounds the work", ge=1, le=100
    )
    promising: float = threshold(
        0.8,
        "gain to be added",
        "linear gain from which a candidate is refitted, if it is close too",
        "a refit finds more",
        ge=0,
        le=1,
    )
    close: float = threshold(
        0.55,
        "best linear gain",
        "linear gain from which a candidate is refitted, if it is promising too",
        "a refit changes the order",
        ge=0,
        le=1,
    )
    clear: float = threshold(
        0.8,
        "best linear gain",
        "linear gain from which a candidate is refitted whose force is linear in its sizes",
        "its linear gain says all of it",
        ge=0,
        le=1,
    )
    same_force: float = threshold(
        0.985,
        "1",
        "correlation from which two candidates make one force",
        "the one with fewer numbers is refitted",
        gt=0,
        lt=1,
    )
    equal_gain: float = threshold(
        0.97,
        "best gain",
        "gain from which refitted candidates are equals",
        "the one that leaves the machine's numbers alone is added",
        gt=0,
        le=1,
    )
    entry: float = threshold(
        0.4,
        "gain that matters",
        "RMS that an entry of an effect's lists must gain on unseen folds",
        "a sine of a map that gains less is none",
        gt=0,
        le=10,
    )
    alike: int = threshold(
        2, "1", "effects of one name, at most", "more sines are the Fourier series of something else", ge=1, le=20
    )

    # --- rivals ---------------------------------------------------------------------------------------------------

    rival_rounds: int = threshold(
        3,
        "1",
        "times that a better candidate takes a cause's place, at most",
        "two that are better in turns would never end",
        ge=1,
        le=20,
    )
    noise_answered: float = threshold(
        0.5,
        "gain of the effect",
        "answer to the encoder's noise from which on an effect explains that noise and is none",
        "a mass that is shaken by noise takes noise out of the force",
        gt=0,
        le=100,
    )
    rival_gain: float = threshold(
        0.7,
        "gain of the cause",
        "linear gain from which a candidate is refitted in a cause's place",
        "a refit finds more",
        ge=0,
        le=1,
    )
    rival_gain_alike: float = threshold(
        0.5,
        "gain of the cause",
        "the same for a candidate that is known to be confused with it",
        "beside others a derivative tells half of an effect that fits to the noise",
        ge=0,
        le=1,
    )
    steps_most: float = threshold(
        0.2,
        "f_C",
        "RMS of the force that an encoder's steps make of the acceleration, as much of which is noise of the record",
        "what hides more than that says of no model that it is adequate",
        ge=0,
        le=10,
    )
    rival_t: float = threshold(
        2.5, "1", "t over blocks up to which two fits are equally good", "two-sided one percent", gt=0, le=100
    )
    rival_excess: float = threshold(
        0.3, "gain that matters", "RMS that a rival may leave more whatever t says", "it does not matter", ge=0, le=10
    )
    rival_share: float = threshold(
        0.15,
        "gain of the cause",
        "RMS that a rival may leave more where t does not tell the two apart",
        "it explains 98 % of the power as well",
        ge=0,
        le=1,
    )
    better: float = threshold(
        0.2,
        "gain that matters",
        "RMS that a candidate must leave less, t telling, to take a cause's place",
        "a cause stays unless something is clearly better",
        ge=0,
        le=10,
    )

    # --- what is named --------------------------------------------------------------------------------------------

    sigmas: float = threshold(
        2.0,
        "standard deviations",
        "difference from none, or from the machine file, that a size must have",
        "95 %, as the interval of its gain",
        gt=0,
        le=100,
    )
    certain: float = threshold(
        10.0,
        "standard deviations",
        "the same of a size that is certain, whatever the interval of its gain, where its cause leaves nothing",
        "what acts in a few blocks alone may be in none of those that the interval draws",
        gt=0,
        le=1000,
    )
    stood_in: float = threshold(
        3.0,
        "noise floors",
        "gain of a wrong number, where elements that switch are stood in for by ones that slip almost at once",
        "that leaves up to 2.7 noise floors, which a Stribeck effect imitates",
        gt=0,
        le=100,
    )
    vague: float = threshold(
        0.5,
        "value",
        "interval from which a number of the machine that does not differ from the file is not determined",
        "half of it may be chance: the file's stays",
        gt=0,
        le=10,
    )
    certain_p: float = threshold(
        1e-4,
        "1",
        "p value from which a cause that is the same all over the record is certain, whatever its gain's interval",
        "a short record has few blocks to draw the interval from",
        gt=0,
        lt=1,
    )
    unexplained: float = threshold(
        0.02,
        "f_C",
        "RMS beyond noise that a complete explanation may leave; the largest of the three counts",
        "laws of friction differ by as much at reversals",
        gt=0,
        le=1,
    )
    unexplained_noise: float = threshold(
        0.5,
        "noise floor",
        "RMS beyond noise that a complete explanation may leave; the largest of the three counts",
        "the floor itself is an estimate",
        ge=0,
        le=10,
    )
    unexplained_share: float = threshold(
        0.15,
        "RMS beyond noise before",
        "RMS beyond noise that a complete explanation may leave; the largest of the three counts",
        "98 % of the power is explained",
        ge=0,
        le=1,
    )
    unexplained_most: float = threshold(
        3.0,
        "noise floor",
        "RMS beyond noise that a machine without causes may leave, whatever the three before it say",
        "what leaves more is not adequate",
        gt=0,
        le=100,
    )
    explained_most: float = threshold(
        1.25,
        "noise floor",
        "RMS beyond noise that named causes may leave, whatever the three of `unexplained` say",
        "what leaves more has not explained the record, however much it gained",
        gt=0,
        le=100,
    )
    unexplained_least: float = threshold(
        0.012,
        "f_C",
        "RMS beyond noise that either may leave, however quiet the record; numbers beside effects only what is small",
        "sampling, integration and a low cutoff leave as much of a log without noise",
        gt=0,
        le=1,
    )
    most_left: float = threshold(
        0.75,
        "RMS beyond noise before",
        "RMS beyond noise that may be left for causes to be listed that are constant over the record",
        "measured axes have what no catalogue has; a quarter must go",
        gt=0,
        le=1,
    )
    inconstant: float = threshold(
        0.3,
        "size",
        "RMS change of a cause's size over the record that rules it out",
        "an imitation fits here and misfits there",
        gt=0,
        le=10,
    )
    constancy_parts: int = threshold(
        6,
        "1",
        "parts of a record that a size is compared in, by time, place and speed",
        "each with several blocks",
        ge=2,
        le=100,
    )
    echo: float = threshold(
        0.1,
        "gain of the other",
        "gain below which a sine of the same period as another effect is none",
        "what the form of a large sine gets wrong comes again with it",
        ge=0,
        le=1,
    )
    curve_left: float = threshold(
        0.5,
        "gain that matters",
        "RMS of what is left as a curve over speed, from which a curve is taken for another one, with curve_share",
        "curves over speed add up to nearly any other one, and what they miss of it is such a curve",
        gt=0,
        le=100,
    )
    curve_share: float = threshold(
        0.3,
        "RMS beyond noise",
        "the same over all that is left",
        "where much else is left the map over speed shows some of that",
        ge=0,
        le=1,
    )
    follows: float = threshold(
        0.5,
        "gain beside the effects",
        "gain of a refitted number without the effects, from which it is a cause of its own",
        "with less it was right for a model without them",
        ge=0,
        le=1,
    )

    # --- where the residual lives ---------------------------------------------------------------------------------

    map_bins: int = threshold(40, "1", "bins of a map of the residual", "a curve to look at", ge=4, le=1000)
    line_power: float = threshold(
        3.0,
        "median power",
        "power of a spectrum's bin that counts as structure",
        "above the scatter of the bins",
        ge=1,
        le=1e6,
    )
