/* The displacement flow of one package over arrays. Compiled with the package's headers:
 *     -DSGMS_FLOW_HEADER='"etel_xy_flow.h"'
 * Relies on: sgms_flow_step, sgms_flow_move, flow_table, FLOW_GATE. */
#include SGMS_FLOW_HEADER

void probe_flow(long n, const double *r0, const double *xi, double *r, double *ratio, double *slope)
{
    for (long i = 0; i < n; i++) {
        const sgms_flow_move moved = sgms_flow_step((sgms_real)r0[i], (sgms_real)xi[i]);
        r[i] = (double)moved.r;
        ratio[i] = (double)moved.ratio;
        slope[i] = (double)moved.slope;
    }
}

double probe_gate(void)
{
    return (double)FLOW_GATE;
}
