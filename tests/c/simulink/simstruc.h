/* What an S-function of level 2 may call, for a block that runs without Simulink: names and types as in its
 * documentation, written for the tests of the emitted S-function. A call that Simulink would not have stops the run. */
#ifndef SIMSTRUC_H
#define SIMSTRUC_H

#include <stddef.h>
#include <stdint.h>

typedef int int_T;
typedef double real_T;
typedef double time_T;
typedef int32_t int32_T;
typedef uint32_t uint32_T;
typedef uint32_t uint_T;
typedef unsigned char boolean_T;
typedef int DTypeId;
typedef struct SimStruct SimStruct;
typedef struct mxArray mxArray;

enum { SS_DOUBLE = 0, SS_INT32 = 6, SS_UINT32 = 7, SS_BOOLEAN = 8 };
enum { USE_DEFAULT_OPERATING_POINT = 1 };
#define SS_OPTION_EXCEPTION_FREE_CODE 0x00000001U
#define UNUSED_ARG(argument) (void)(argument)

void ssSetNumSFcnParams(SimStruct *S, int_T number);
int_T ssGetNumSFcnParams(const SimStruct *S);
int_T ssGetSFcnParamsCount(const SimStruct *S);
const mxArray *ssGetSFcnParam(const SimStruct *S, int_T index);
void ssSetSFcnParamTunable(SimStruct *S, int_T index, int_T tunable);
void ssSetErrorStatus(SimStruct *S, const char *text);
const char *ssGetErrorStatus(const SimStruct *S);

int_T ssSetNumInputPorts(SimStruct *S, int_T number);
int_T ssGetNumInputPorts(const SimStruct *S);
int_T ssSetNumOutputPorts(SimStruct *S, int_T number);
void ssSetInputPortWidth(SimStruct *S, int_T port, int_T width);
void ssSetInputPortRequiredContiguous(SimStruct *S, int_T port, int_T required);
void ssSetInputPortDirectFeedThrough(SimStruct *S, int_T port, int_T through);
void ssSetOutputPortWidth(SimStruct *S, int_T port, int_T width);
void ssSetOutputPortDataType(SimStruct *S, int_T port, DTypeId type);
const real_T *ssGetInputPortRealSignal(const SimStruct *S, int_T port);
real_T *ssGetOutputPortRealSignal(const SimStruct *S, int_T port);
void *ssGetOutputPortSignal(const SimStruct *S, int_T port);

void ssSetNumDWork(SimStruct *S, int_T number);
void ssSetDWorkWidth(SimStruct *S, int_T index, int_T width);
void ssSetDWorkDataType(SimStruct *S, int_T index, DTypeId type);
void *ssGetDWork(const SimStruct *S, int_T index);

void ssSetNumSampleTimes(SimStruct *S, int_T number);
void ssSetSampleTime(SimStruct *S, int_T index, time_T period);
void ssSetOffsetTime(SimStruct *S, int_T index, time_T offset);
void ssSetOperatingPointCompliance(SimStruct *S, int compliance);
void ssSetOptions(SimStruct *S, uint_T options);

int mxIsNumeric(const mxArray *array);
int mxIsLogical(const mxArray *array);
int mxIsComplex(const mxArray *array);
size_t mxGetNumberOfElements(const mxArray *array);
double mxGetScalar(const mxArray *array);

#endif
