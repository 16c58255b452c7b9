/* Matrix code as it is commonly taken: row-major, any size, no structure used. */
#ifndef YARDSTICK_MATRIX_H
#define YARDSTICK_MATRIX_H

/* c (n, m) = a (n, k) b (k, m), b transposed (m, k) where asked. */
static void multiply(const float *a, const float *b, float *c, int n, int k, int m, int transposed)
{
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < m; j++) {
            float sum = 0.0f;
            for (int l = 0; l < k; l++) {
                sum += a[i * k + l] * (transposed ? b[j * k + l] : b[l * m + j]);
            }
            c[i * m + j] = sum;
        }
    }
}

#endif
