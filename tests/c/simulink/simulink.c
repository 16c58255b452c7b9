/* Stands at the end of an S-function, as Simulink's own file of this name: the stub's block, and how a test runs it. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { STUB_MOST = 16, STUB_WIDEST = 64 };

struct mxArray {
    double value;
    size_t elements;
};

typedef struct {
    int_T width;
    DTypeId type;
    int contiguous, through;
    union {
        real_T real[STUB_WIDEST];
        int32_T integer[STUB_WIDEST];
        uint32_T word[STUB_WIDEST];
        boolean_T flag[STUB_WIDEST];
    } signal;
} stub_port;

struct SimStruct {
    int_T expected, given, inputs, outputs, works, sample_times;
    mxArray dialog[STUB_MOST];
    int tunable[STUB_MOST];
    stub_port input[STUB_MOST], output[STUB_MOST];
    int_T work_width[STUB_MOST];
    void *work[STUB_MOST];
    time_T period, offset;
    const char *error;
    int compliance;
    uint_T options;
};

/* Whatever Simulink would refuse, or would crash on. */
static void stub_need(int holds, const char *what)
{
    if (!holds) {
        fprintf(stderr, "S-function: %s\n", what);
        abort();
    }
}

void ssSetNumSFcnParams(SimStruct *S, int_T number)
{
    S->expected = number;
}

int_T ssGetNumSFcnParams(const SimStruct *S)
{
    return S->expected;
}

int_T ssGetSFcnParamsCount(const SimStruct *S)
{
    return S->given;
}

const mxArray *ssGetSFcnParam(const SimStruct *S, int_T index)
{
    stub_need(index >= 0 && index < S->given, "a parameter that there is not");
    return &S->dialog[index];
}

void ssSetSFcnParamTunable(SimStruct *S, int_T index, int_T tunable)
{
    stub_need(index >= 0 && index < S->expected, "a parameter that there is not");
    S->tunable[index] = tunable;
}

void ssSetErrorStatus(SimStruct *S, const char *text)
{
    S->error = text;
}

const char *ssGetErrorStatus(const SimStruct *S)
{
    return S->error;
}

int_T ssSetNumInputPorts(SimStruct *S, int_T number)
{
    stub_need(number <= STUB_MOST, "more inputs than the stub has");
    S->inputs = number;
    return 1;
}

int_T ssGetNumInputPorts(const SimStruct *S)
{
    return S->inputs;
}

int_T ssSetNumOutputPorts(SimStruct *S, int_T number)
{
    stub_need(number <= STUB_MOST, "more outputs than the stub has");
    S->outputs = number;
    return 1;
}

static stub_port *stub_input(const SimStruct *S, int_T port)
{
    stub_need(port >= 0 && port < S->inputs, "an input that there is not");
    return (stub_port *)&S->input[port];
}

static stub_port *stub_output(const SimStruct *S, int_T port)
{
    stub_need(port >= 0 && port < S->outputs, "an output that there is not");
    return (stub_port *)&S->output[port];
}

void ssSetInputPortWidth(SimStruct *S, int_T port, int_T width)
{
    stub_need(width == 1, "an input that is no scalar");
    stub_input(S, port)->width = width;
}

void ssSetInputPortRequiredContiguous(SimStruct *S, int_T port, int_T required)
{
    stub_input(S, port)->contiguous = required;
}

void ssSetInputPortDirectFeedThrough(SimStruct *S, int_T port, int_T through)
{
    stub_input(S, port)->through = through;
}

void ssSetOutputPortWidth(SimStruct *S, int_T port, int_T width)
{
    stub_need(width > 0 && width <= STUB_WIDEST, "an output wider than the stub has");
    stub_output(S, port)->width = width;
}

void ssSetOutputPortDataType(SimStruct *S, int_T port, DTypeId type)
{
    stub_output(S, port)->type = type;
}

const real_T *ssGetInputPortRealSignal(const SimStruct *S, int_T port)
{
    const stub_port *found = stub_input(S, port);
    stub_need(found->contiguous && found->through, "an input read that was not asked for as contiguous or fed through");
    return found->signal.real;
}

real_T *ssGetOutputPortRealSignal(const SimStruct *S, int_T port)
{
    stub_need(stub_output(S, port)->type == SS_DOUBLE, "a real signal of an output that is none");
    return stub_output(S, port)->signal.real;
}

void *ssGetOutputPortSignal(const SimStruct *S, int_T port)
{
    return &stub_output(S, port)->signal;
}

void ssSetNumDWork(SimStruct *S, int_T number)
{
    stub_need(number <= STUB_MOST, "more work vectors than the stub has");
    S->works = number;
}

void ssSetDWorkWidth(SimStruct *S, int_T index, int_T width)
{
    stub_need(index >= 0 && index < S->works, "a work vector that there is not");
    S->work_width[index] = width;
}

void ssSetDWorkDataType(SimStruct *S, int_T index, DTypeId type)
{
    stub_need(index >= 0 && index < S->works && type == SS_DOUBLE, "a work vector that there is not, or of no doubles");
}

void *ssGetDWork(const SimStruct *S, int_T index)
{
    stub_need(index >= 0 && index < S->works && S->work[index] != NULL, "a work vector before there is one");
    return S->work[index];
}

void ssSetNumSampleTimes(SimStruct *S, int_T number)
{
    S->sample_times = number;
}

void ssSetSampleTime(SimStruct *S, int_T index, time_T period)
{
    stub_need(index >= 0 && index < S->sample_times, "a sample time that there is not");
    S->period = period;
}

void ssSetOffsetTime(SimStruct *S, int_T index, time_T offset)
{
    stub_need(index >= 0 && index < S->sample_times, "a sample time that there is not");
    S->offset = offset;
}

void ssSetOperatingPointCompliance(SimStruct *S, int compliance)
{
    S->compliance = compliance;
}

void ssSetOptions(SimStruct *S, uint_T options)
{
    S->options = options;
}

int mxIsNumeric(const mxArray *array)
{
    return array->elements > 0;
}

int mxIsLogical(const mxArray *array)
{
    (void)array;
    return 0;
}

int mxIsComplex(const mxArray *array)
{
    (void)array;
    return 0;
}

size_t mxGetNumberOfElements(const mxArray *array)
{
    return array->elements;
}

double mxGetScalar(const mxArray *array)
{
    stub_need(array->elements > 0, "the value of an empty array");
    return array->value;
}

/* --- how a test runs it ------------------------------------------------------------------------------------------ */

SimStruct *stub_block(const double *dialog, int given, const int *elements);
const char *stub_error(const SimStruct *S);
const char *stub_set(SimStruct *S, int index, double value);
void stub_step(SimStruct *S, const double *inputs, double *outputs);
void stub_point(SimStruct *S, SimStruct *from);
void stub_layout(const SimStruct *S, double *period, int *ports, int *widths, int *tunable);
void stub_end(SimStruct *S);

/* A block as Simulink starts one; with an error status it is not to be run. */
SimStruct *stub_block(const double *dialog, int given, const int *elements)
{
    SimStruct *S = calloc(1, sizeof *S);
    stub_need(S != NULL && given <= STUB_MOST, "no memory");
    S->given = given;
    for (int i = 0; i < given; i++) {
        S->dialog[i].value = dialog[i];
        S->dialog[i].elements = (size_t)elements[i];
    }
    mdlInitializeSizes(S);
    if (S->expected != S->given) {
        S->error = "number of parameters";
    }
    if (S->error != NULL) {
        return S;
    }
    for (int i = 0; i < S->works; i++) {
        S->work[i] = malloc((size_t)S->work_width[i] * sizeof(real_T));
        stub_need(S->work[i] != NULL, "no memory");
        memset(S->work[i], 0xa5, (size_t)S->work_width[i] * sizeof(real_T));
    }
    mdlInitializeSampleTimes(S);
    stub_need(S->compliance == USE_DEFAULT_OPERATING_POINT && S->options == SS_OPTION_EXCEPTION_FREE_CODE, "options");
    mdlInitializeConditions(S);
    return S;
}

const char *stub_error(const SimStruct *S)
{
    return S->error;
}

/* A parameter changed while it runs; the error that refuses it, which leaves the block as it was. */
const char *stub_set(SimStruct *S, int index, double value)
{
    const double before = S->dialog[index].value;
    const char *said;
    stub_need(S->tunable[index], "a parameter that is not tunable");
    S->dialog[index].value = value;
    mdlCheckParameters(S);
    said = S->error;
    if (said != NULL) {
        S->dialog[index].value = before;
        S->error = NULL;
    } else {
        mdlProcessParameters(S);
    }
    return said;
}

/* One sample hit; all outputs one after the other, as doubles. */
void stub_step(SimStruct *S, const double *inputs, double *outputs)
{
    for (int i = 0; i < S->inputs; i++) {
        S->input[i].signal.real[0] = inputs[i];
    }
    mdlOutputs(S, 0);
    for (int i = 0; i < S->outputs; i++) {
        const stub_port *port = &S->output[i];
        for (int k = 0; k < port->width; k++) {
            *outputs++ = port->type == SS_DOUBLE   ? port->signal.real[k]
                         : port->type == SS_INT32  ? (double)port->signal.integer[k]
                         : port->type == SS_UINT32 ? (double)port->signal.word[k]
                                                   : (double)port->signal.flag[k];
        }
    }
}

/* The operating point of another block: its work vectors. */
void stub_point(SimStruct *S, SimStruct *from)
{
    for (int i = 0; i < S->works; i++) {
        memcpy(S->work[i], from->work[i], (size_t)S->work_width[i] * sizeof(real_T));
    }
}

void stub_layout(const SimStruct *S, double *period, int *ports, int *widths, int *tunable)
{
    *period = S->offset > 0.0 ? -1.0 : S->period;
    ports[0] = S->inputs;
    ports[1] = S->outputs;
    for (int i = 0; i < S->outputs; i++) {
        widths[i] = S->output[i].width;
    }
    for (int i = 0; i < S->expected; i++) {
        tunable[i] = S->tunable[i];
    }
}

void stub_end(SimStruct *S)
{
    mdlTerminate(S);
    for (int i = 0; i < S->works; i++) {
        free(S->work[i]);
    }
    free(S);
}
