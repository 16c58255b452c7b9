/* Small dense least squares in square-root form. Row-major; nothing forms J'J: floats suffice. */
#ifndef SGMS_LINALG_H
#define SGMS_LINALG_H

#include "sgms_math.h"

/* First column of a row to work on, where those before `c` hold zeros. */
#if SGMS_VECTORS
#define SGMS_FROM(c) (0 * (c))
#else
#define SGMS_FROM(c) (c)
#endif

/* A sum of squares below this has lost digits and counts as zero. */
#if SGMS_SINGLE
#define SGMS_LEAST_SQUARE 1e-30f
#else
#define SGMS_LEAST_SQUARE 1e-290
#endif

/* One Householder reflection of a pivot row and `rows` rows below it, all `width` long, that makes
 * column c of those rows zero; they lie `stride` numbers apart, anywhere. v: `rows` numbers.
 *
 * Where processors have vectors it runs over whole rows: the columns already done hold zeros and
 * stay what they are, and a loop of constant length is one that compilers vectorise. Inlined, so
 * that the lengths are constants where the caller's are. */
static SGMS_INLINE void sgms_reflect(
    sgms_real *SGMS_RESTRICT pivot_row, sgms_real *SGMS_RESTRICT below, int rows, int stride,
    int width, int c, sgms_real *SGMS_RESTRICT v)
{
    sgms_real square = SGMS_R(0.0);
    SGMS_UNROLL
    for (int i = 0; i < rows; i++) {
        v[i] = below[i * stride + c];
        square += v[i] * v[i];
    }
    if (square > SGMS_LEAST_SQUARE) {
        const sgms_real pivot = pivot_row[c];
        const sgms_real norm = sgms_sqrt(pivot * pivot + square);
        const sgms_real diagonal = pivot > SGMS_R(0.0) ? -norm : norm;
        const sgms_real head = pivot - diagonal; /* reflector (1, v) times this */
        const sgms_real over_head = SGMS_R(1.0) / head;
        const sgms_real scale = -head / diagonal;
        SGMS_UNROLL
        for (int i = 0; i < rows; i++) {
            v[i] *= over_head;
        }
        for (int j = SGMS_FROM(c + 1); j < width; j++) {
            sgms_real dot = pivot_row[j];
            SGMS_UNROLL
            for (int i = 0; i < rows; i++) {
                dot += v[i] * below[i * stride + j];
            }
            dot *= scale;
            pivot_row[j] -= dot;
            SGMS_UNROLL
            for (int i = 0; i < rows; i++) {
                below[i * stride + j] -= dot * v[i];
            }
        }
        pivot_row[c] = diagonal;
    }
    if (square >= SGMS_R(0.0)) { /* what is not a number stays, to be found */
        SGMS_UNROLL
        for (int i = 0; i < rows; i++) {
            below[i * stride + c] = SGMS_R(0.0);
        }
    }
}

/* Householder reflections that make the first `columns` columns of the rows x width matrix a upper
 * triangular, `rows` columns at most; rows lie `stride` numbers apart. v: `rows` numbers. */
static inline void sgms_qr(
    sgms_real *SGMS_RESTRICT a, int rows, int stride, int width, int columns,
    sgms_real *SGMS_RESTRICT v)
{
    for (int c = 0; c < columns; c++) {
        sgms_reflect(a + c * stride, a + (c + 1) * stride, rows - c - 1, stride, width, c, v);
    }
}

/* Plane rotation of two rows that makes `*low` zero and `*high` their norm; a row's own column c,
 * which holds these two numbers, may be among the `width` columns. */
static SGMS_INLINE void sgms_rotate(
    sgms_real *high, const sgms_real low, sgms_real *SGMS_RESTRICT high_row,
    sgms_real *SGMS_RESTRICT low_row, int from, int width)
{
    const sgms_real square = *high * *high + low * low;
    const sgms_real over_norm = sgms_inverse_sqrt(square);
    const sgms_real cosine = *high * over_norm;
    const sgms_real sine = low * over_norm;
    for (int j = SGMS_FROM(from); j < width; j++) {
        const sgms_real kept = high_row[j];
        high_row[j] = cosine * kept + sine * low_row[j];
        low_row[j] = cosine * low_row[j] - sine * kept;
    }
    *high = square * over_norm;
}

/* Fold one row of length n + 1 (coefficients, right side) into the n x (n + 1) upper triangular
 * factor r by plane rotations. The row is used up. */
static SGMS_INLINE void sgms_qr_add_row(
    sgms_real *SGMS_RESTRICT r, int n, sgms_real *SGMS_RESTRICT row)
{
    for (int c = 0; c < n; c++) {
        sgms_real *const top = r + c * (n + 1);
        const sgms_real low = row[c];
        /* too small for a norm is zero; what is not a number goes on */
        if (!(low * low == SGMS_R(0.0))) {
            sgms_real high = top[c];
            sgms_rotate(&high, low, top, row, c + 1, n + 1);
            top[c] = high;
            row[c] = SGMS_R(0.0);
        }
    }
}

/* Let the last `count` of n unknowns walk: their variances in the n x (n + 1) upper triangular
 * factor r grow by growth^2. carrier: n + 1 numbers.
 *
 * x' = x + growth w with w ~ N(0, 1): eliminate w from [1 0; -growth r, r], one unknown after the
 * other. Rotations from the last row upwards leave r triangular. */
static SGMS_INLINE void sgms_qr_grow(
    sgms_real *SGMS_RESTRICT r, int n, int count, const sgms_real *growth,
    sgms_real *SGMS_RESTRICT carrier)
{
    for (int k = n - count; k < n; k++) {
        const sgms_real by = growth[k - n + count];
        sgms_real head = SGMS_R(1.0);
        if (by == SGMS_R(0.0)) {
            continue;
        }
        for (int j = 0; j <= n; j++) {
            carrier[j] = SGMS_R(0.0);
        }
        for (int i = k; i >= 0; i--) {
            sgms_real *const row = r + i * (n + 1);
            sgms_rotate(&head, -by * row[k], carrier, row, i, n + 1);
        }
    }
}

/* Solve r x = b, r upper triangular in the first n columns of an n x width matrix. */
static inline void sgms_back_substitute(
    const sgms_real *r, int n, int width, const sgms_real *b, sgms_real *x)
{
    for (int i = n - 1; i >= 0; i--) {
        sgms_real sum = b[i];
        for (int j = i + 1; j < n; j++) {
            sum -= r[i * width + j] * x[j];
        }
        x[i] = sum / r[i * width + i];
    }
}

/* Variances diag((r' r)^-1) of the n x width upper triangular factor r; work holds n numbers. */
static inline void sgms_variances(
    const sgms_real *r, int n, int width, sgms_real *variance, sgms_real *work)
{
    for (int i = 0; i < n; i++) {
        variance[i] = SGMS_R(0.0);
    }
    /* Column c of r^-1 has entries in rows 0..c; row sums of squares are the variances. */
    for (int c = 0; c < n; c++) {
        work[c] = SGMS_R(1.0) / r[c * width + c];
        variance[c] += work[c] * work[c];
        for (int i = c - 1; i >= 0; i--) {
            sgms_real sum = SGMS_R(0.0);
            for (int j = i + 1; j <= c; j++) {
                sum -= r[i * width + j] * work[j];
            }
            work[i] = sum / r[i * width + i];
            variance[i] += work[i] * work[i];
        }
    }
}

/* Minimise |r x - b| over lower <= x <= upper; r is n x width, upper triangular. */
typedef struct {
    const sgms_real *r;
    int n, width;
    const sgms_real *b, *lower, *upper;
} sgms_box;

/* Iterations at most: the longest of two million random problems of 1 to 10 unknowns took 2 n + 8.
 * Only rounding, between bounds that are as good as each other, asks for more. */
#define SGMS_BOX_ITERATIONS(n) (3 * (n) + 4)

/* Solve it by a primal active-set method.
 *
 * Every iterate is feasible and no worse than the one before it, so stopping at the iteration limit
 * still leaves a usable x. work: (n + 1)^2 numbers; pinned: n entries, -1 at the lower bound, 1 at
 * the upper, 0 free, on return. Returns the number of bounds that are active. */
static inline int sgms_box_least_squares(
    const sgms_box *box, sgms_real *x, int *pinned, sgms_real *work)
{
    const sgms_real *const r = box->r, *const b = box->b, *const lower = box->lower,
                           *const upper = box->upper;
    const int n = box->n, width = box->width;
    int active = 0;
    sgms_back_substitute(r, n, width, b, x);
    for (int i = 0; i < n; i++) {
        pinned[i] = x[i] < lower[i] ? -1 : (x[i] > upper[i] ? 1 : 0);
        x[i] = pinned[i] < 0 ? lower[i] : (pinned[i] > 0 ? upper[i] : x[i]);
        active += pinned[i] != 0 ? 1 : 0;
    }
    if (active == 0) {
        return 0;
    }
    for (int iteration = 0; iteration < SGMS_BOX_ITERATIONS(n); iteration++) {
        /* Least squares over the free variables, the pinned ones moved to the right side. */
        int free_count = 0;
        int blocking = -1;
        sgms_real step = SGMS_R(1.0);
        for (int i = 0; i < n; i++) {
            free_count += pinned[i] == 0 ? 1 : 0;
        }
        for (int i = 0; i < n; i++) {
            int column = 0;
            sgms_real *row = work + i * (free_count + 1);
            row[free_count] = b[i];
            for (int j = 0; j < n; j++) {
                const sgms_real entry = j >= i ? r[i * width + j] : SGMS_R(0.0);
                if (pinned[j] == 0) {
                    row[column] = entry;
                    column++;
                } else {
                    row[free_count] -= entry * x[j];
                }
            }
        }
        sgms_qr(work, n, free_count + 1, free_count + 1, free_count, work + n * (n + 1));
        for (int c = free_count - 1; c >= 0; c--) { /* the solution replaces the right side */
            sgms_real *row = work + c * (free_count + 1);
            for (int j = c + 1; j < free_count; j++) {
                row[free_count] -= row[j] * work[j * (free_count + 1) + free_count];
            }
            row[free_count] /= row[c];
        }
        /* Go there, or to the first bound on the way. */
        for (int i = 0, c = 0; i < n; i++) {
            if (pinned[i] == 0) {
                const sgms_real move = work[c * (free_count + 1) + free_count] - x[i];
                const sgms_real bound = move < SGMS_R(0.0) ? lower[i] : upper[i];
                if (sgms_fabs(move) * step > sgms_fabs(bound - x[i])) {
                    step = (bound - x[i]) / move;
                    blocking = move < SGMS_R(0.0) ? -(i + 2) : i;
                }
                c++;
            }
        }
        for (int i = 0, c = 0; i < n; i++) {
            if (pinned[i] == 0) {
                x[i] += step * (work[c * (free_count + 1) + free_count] - x[i]);
                x[i] = x[i] < lower[i] ? lower[i]
                                       : (x[i] > upper[i] ? upper[i] : x[i]); /* rounding */
                c++;
            }
        }
        if (blocking != -1) {
            const int i = blocking < 0 ? -blocking - 2 : blocking;
            pinned[i] = blocking < 0 ? -1 : 1;
            x[i] = blocking < 0 ? lower[i] : upper[i];
            active++;
            continue;
        }
        /* Optimal over the free variables: release the bound with the largest wrong gradient. */
        {
            int worst = -1;
            sgms_real strongest = SGMS_R(0.0);
            for (int i = 0; i < n; i++) {
                work[i] = -b[i];
                for (int j = i; j < n; j++) {
                    work[i] += r[i * width + j] * x[j];
                }
            }
            for (int j = 0; j < n; j++) {
                sgms_real gradient = SGMS_R(0.0);
                sgms_real size = SGMS_R(0.0);
                for (int i = 0; i <= j; i++) {
                    gradient += r[i * width + j] * work[i];
                    size += sgms_fabs(r[i * width + j] * work[i]);
                }
                /* a gradient within rounding of zero releases none */
                if ((sgms_real)pinned[j] * gradient > SGMS_ROUNDING * size &&
                    sgms_fabs(gradient) > strongest) {
                    worst = j;
                    strongest = sgms_fabs(gradient);
                }
            }
            if (worst < 0) {
                break;
            }
            pinned[worst] = 0;
            active--;
        }
    }
    return active;
}

#endif
