/* A free run through an FMU of FMI 3.0 in event mode, from measured history; as in
 * loop2.c. */
#include "fmi3Functions.h"

#include <dlfcn.h>
#include <stdlib.h>

int run(const char *path, const char *token, const long *sizes, double step,
        const double *lags, const double *u, double *out);

#define OF(name) (*(void **)(&name) = dlsym(library, "fmi3" #name))
#define DO(call)                                                                       \
    if (result == 0 && (call) != fmi3OK) {                                             \
        result = __LINE__;                                                             \
    }

int run(const char *path, const char *token, const long *sizes, double step,
        const double *lags, const double *u, double *out)
{
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    fmi3Instance (*InstantiateCoSimulation)(
        fmi3String, fmi3String, fmi3String, fmi3Boolean, fmi3Boolean, fmi3Boolean,
        fmi3Boolean, const fmi3ValueReference *, size_t, fmi3InstanceEnvironment,
        fmi3LogMessageCallback, fmi3IntermediateUpdateCallback);
    fmi3Status (*EnterInitializationMode)(fmi3Instance, fmi3Boolean, fmi3Float64,
                                          fmi3Float64, fmi3Boolean, fmi3Float64);
    fmi3Status (*ExitInitializationMode)(fmi3Instance);
    fmi3Status (*EnterEventMode)(fmi3Instance);
    fmi3Status (*UpdateDiscreteStates)(fmi3Instance, fmi3Boolean *, fmi3Boolean *,
                                       fmi3Boolean *, fmi3Boolean *, fmi3Boolean *,
                                       fmi3Float64 *);
    fmi3Status (*EnterStepMode)(fmi3Instance);
    fmi3Status (*SetInt64)(fmi3Instance, const fmi3ValueReference *, size_t,
                           const fmi3Int64 *, size_t);
    fmi3Status (*SetFloat64)(fmi3Instance, const fmi3ValueReference *, size_t,
                             const fmi3Float64 *, size_t);
    fmi3Status (*GetFloat64)(fmi3Instance, const fmi3ValueReference *, size_t,
                             fmi3Float64 *, size_t);
    fmi3Status (*DoStep)(fmi3Instance, fmi3Float64, fmi3Float64, fmi3Boolean,
                         fmi3Boolean *, fmi3Boolean *, fmi3Boolean *, fmi3Float64 *);
    void (*FreeInstance)(fmi3Instance);
    const size_t inputs = (size_t)sizes[1];
    const size_t outputs = (size_t)sizes[2];
    const size_t lagged = (size_t)sizes[4];
    const fmi3ValueReference start = (fmi3ValueReference)sizes[3];
    const fmi3Int64 given = 2;
    fmi3ValueReference *at = malloc((inputs + outputs + lagged + 1) * sizeof(*at));
    fmi3ValueReference *of = at + inputs;
    fmi3ValueReference *lag = of + outputs;
    fmi3Boolean no[5];
    fmi3Float64 when;
    fmi3Instance c;
    int result = 0;
    size_t t;
    size_t k;
    if (library == NULL || at == NULL) {
        return __LINE__;
    }
    if (!OF(InstantiateCoSimulation) || !OF(EnterInitializationMode) ||
        !OF(ExitInitializationMode) || !OF(EnterEventMode) ||
        !OF(UpdateDiscreteStates) || !OF(EnterStepMode) || !OF(SetInt64) ||
        !OF(SetFloat64) || !OF(GetFloat64) || !OF(DoStep) || !OF(FreeInstance)) {
        return __LINE__;
    }
    for (k = 0; k < inputs + outputs; k++) {
        at[k] = (fmi3ValueReference)k;
    }
    for (k = 0; k < lagged; k++) {
        lag[k] = start + 1 + (fmi3ValueReference)k;
    }
    c = InstantiateCoSimulation("run", token, NULL, false, false, true, false, NULL, 0,
                                NULL, NULL, NULL);
    DO(c == NULL ? fmi3Error : fmi3OK)
    DO(EnterInitializationMode(c, false, 0.0, 0.0, false, 0.0))
    DO(SetInt64(c, &start, 1, &given, 1))
    DO(SetFloat64(c, lag, lagged, lags, lagged))
    DO(SetFloat64(c, at, inputs, u, inputs))
    DO(ExitInitializationMode(c))
    for (t = 0; t < (size_t)sizes[0] && result == 0; t++) {
        DO(SetFloat64(c, at, inputs, &u[t * inputs], inputs))
        DO(UpdateDiscreteStates(c, &no[0], &no[1], &no[2], &no[3], &no[4], &when))
        DO(GetFloat64(c, of, outputs, &out[t * outputs], outputs))
        DO(EnterStepMode(c))
        DO(DoStep(c, (double)t * step, step, true, &no[0], &no[1], &no[2], &when))
        DO(EnterEventMode(c))
    }
    FreeInstance(c);
    free(at);
    (void)dlclose(library);
    return result;
}
