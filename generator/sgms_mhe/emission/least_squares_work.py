"""Worst-case work of the least squares of an update: its units and the feedback, in operations."""

from sgms_mhe.emission.context import PackageView
from sgms_mhe.emission.operations import INVERSE_SQRT, SQRT, operations_of

# --- small least squares, as sgms_linalg.h does them where nothing vectorises -----------------------------------------


def reflection(rows: int, width: int, column: int) -> int:
    """One Householder reflection of a pivot row and `rows` rows below it, from `column` on."""
    return 3 * rows + 9 + SQRT + (width - column - 1) * (4 * rows + 2)


def rotation(columns: int) -> int:
    """One plane rotation of two rows over so many columns."""
    return 6 + INVERSE_SQRT + 6 * columns


def added_row(n: int) -> int:
    """A row folded into a triangular factor of n unknowns."""
    return sum(2 + rotation(n - c) for c in range(n))


def grown(n: int, count: int) -> int:
    """Growth of the variances of the last `count` of n unknowns."""
    return sum(1 + sum(2 + rotation(n + 1 - i) for i in range(k + 1)) for k in range(n - count, n))


def back_substitution(n: int) -> int:
    """A triangular system of n unknowns."""
    return n * n


def variances(n: int) -> int:
    """Variances of n unknowns from their triangular factor."""
    return sum(3 + sum(2 * (c - i) + 3 for i in range(c)) for c in range(n))


def box_least_squares(n: int) -> int:
    """A triangular least-squares problem of n unknowns in a box, to the limit of its iterations."""
    eliminated = sum(reflection(n - c - 1, n + 1, c) for c in range(n))
    iteration = eliminated + (9 * n * n + 34 * n) // 2 + 1
    return back_substitution(n) + 2 * n + (3 * n + 4) * iteration


# --- an update --------------------------------------------------------------------------------------------------------


class LeastSquaresWork:
    """Operations at most of measurements, of the sweep's units and of the feedback.

    Attributes:
        folded: of a measurement into the factor.
        taken: of one inside the newest interval; a filter folds it at once.
        expand: of a node from its successor's. kept: of the triangle of the measurements inside an interval.
        start: of the sweep. condense: a node out of the factor; condensed: without the newest one's measurement.
        drift: of what enters of it. ended: of the end of the interval that is linearised anew.
    """

    def __init__(self, of: PackageView) -> None:
        self.of, self.sizes, self.variant = of, of.sizes, of.variant
        sizes, n_x, n_p = of.sizes, of.sizes.states, of.sizes.parameters
        entered, factor, width = sizes.entered, sizes.factor_rows, sizes.factor_rows + 1
        self.condensed = sum(reflection(rows, sizes.kept_width, c) for c, rows in enumerate(of.couplings.reach))
        self.condensed += sum(reflection(n_x - 1 - c, width, c) for c in range(n_x - 1)) + n_x
        self.output = operations_of(of.model.output)
        self.start_row = self.output + 2 * factor + 1 + width
        weighed = sum(2 * i + 5 for i in range(factor)) + 30 + SQRT + (7 + SQRT if of.variant.self_scaling else 0)
        self.folded = weighed + width + added_row(factor)
        self.fold_start = self.start_row + added_row(factor)
        self.drift = variances(n_p) + 36 * n_p + grown(factor, n_p) if of.variant.drifts else 0
        # The map of an interval from its blocks, a measurement inside by it, its defects, the triangle of its rows.
        by_state = (1 + entered + g.n_q * (1 + 2 * entered) + g.m * (4 + 2 * entered) for g in sizes.groups)
        blocks = sum(g.n_blocks * g.m * each for g, each in zip(sizes.groups, by_state, strict=True))
        inner_row = blocks + self.output + 1 + 2 * n_x * (sizes.coupled + entered + 1) + 2 * n_p
        self.taken = inner_row + (0 if of.variant.horizon else self.folded)
        self.renewed = inner_row + width
        self.ends = blocks + n_x * (3 * sizes.coupled + 4 * entered + 3)
        self.kept = sum(reflection(sizes.inner - 1 - c, width, c) for c in range(min(sizes.inner, factor)))
        self.expand = 2 * n_x * (n_x + n_p) + back_substitution(n_x)
        self.ended = 0
        self.start = self.fold_start + self.drift + (2 * n_x + n_p if self.variant.fixed else 0)
        self.condense = self.condensed + self.fold_start
        if self.variant.relinearise == "auto":
            self.expand += n_x * (2 * sizes.coupled + 2 * entered + 6) + 2
            self.ended = self.ends + self.kept if sizes.slots > 1 else 0
        if self.variant.relinearise == "all":
            self.start += sizes.slots * sum(map(len, sizes.block_states))
            self.condense += self.ends
            self.kept = 0

    def steps(self, step: int) -> list[int]:
        """Return the operations of each step of the older intervals: measurements inside, the start and the end."""
        sizes, relinearise = self.sizes, self.variant.relinearise
        if relinearise == "newest" or sizes.slots == 1:
            return []
        steps = [step] * sizes.steps
        for j in range(sizes.inner):
            steps[(j + 1) * sizes.spacing - 1] += self.renewed * (sizes.slots - 1 if relinearise == "all" else 1)
        if relinearise == "auto":
            steps[0] += sum(map(len, sizes.block_states))
        return steps

    def readings(self) -> int:
        """Measurements of an older interval into the factor."""
        sizes, width = self.sizes, self.sizes.factor_rows + 1
        if not sizes.inner:
            return self.fold_start
        is_triangle = self.variant.relinearise != "all"
        rows = 1 + (sizes.inner_rows if is_triangle else sizes.inner)
        reach = (min(c + 2, rows) if is_triangle else rows for c in range(sizes.factor_rows))
        return self.start_row + sum(reflection(below, width, c) for c, below in enumerate(reach))

    def feedback(self) -> int:
        """An update whose preparation is done."""
        sizes, variant, model = self.sizes, self.variant, self.of.model
        n_x, n_p, factor = sizes.states, sizes.parameters, sizes.factor_rows
        newest = self.ends + self.condensed + (0 if variant.horizon else self.drift)
        reading = self.start_row - factor - 1 + self.folded
        solved = box_least_squares(n_p) if variant.bounded else back_substitution(n_p)
        solved += 2 * n_x * factor + back_substitution(n_x)
        checked = variances(n_p) + 3 * n_x + 4 * n_p + 14 + self.output
        if variant.self_scaling:  # the measurement takes its innovation in, the update the factors on variances
            checked += 24 + 19 * n_p
        if self.of.weights.noise_length > 0.0:  # noise that comes with the path
            checked += 8 + SQRT
        again = n_x + n_p + operations_of(model.parameter_terms) + sum(map(len, sizes.block_states))
        if variant.bounded and not variant.horizon:  # the posterior's mean moves into the bounds
            again += factor * (factor + 1)
        return newest + reading + solved + checked + again
