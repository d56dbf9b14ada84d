/* A free run through an FMU of FMI 2.0, from measured history. sizes: samples, inputs,
 * outputs, the reference of `start`, measured values behind it. Returns the number of
 * the line that has failed, 0 if none. */
#include "fmi2Functions.h"

#include <dlfcn.h>
#include <stdlib.h>

int run(const char *path, const char *token, const long *sizes, double step,
        const double *lags, const double *u, double *out);

#define OF(name) (*(void **)(&name) = dlsym(library, "fmi2" #name))
#define DO(call)                                                                       \
    if (result == 0 && (call) != fmi2OK) {                                             \
        result = __LINE__;                                                             \
    }

int run(const char *path, const char *token, const long *sizes, double step,
        const double *lags, const double *u, double *out)
{
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    fmi2Component (*Instantiate)(fmi2String, fmi2Type, fmi2String, fmi2String,
                                 const fmi2CallbackFunctions *, fmi2Boolean,
                                 fmi2Boolean);
    fmi2Status (*SetupExperiment)(fmi2Component, fmi2Boolean, fmi2Real, fmi2Real,
                                  fmi2Boolean, fmi2Real);
    fmi2Status (*EnterInitializationMode)(fmi2Component);
    fmi2Status (*ExitInitializationMode)(fmi2Component);
    fmi2Status (*SetInteger)(fmi2Component, const fmi2ValueReference *, size_t,
                             const fmi2Integer *);
    fmi2Status (*SetReal)(fmi2Component, const fmi2ValueReference *, size_t,
                          const fmi2Real *);
    fmi2Status (*GetReal)(fmi2Component, const fmi2ValueReference *, size_t,
                          fmi2Real *);
    fmi2Status (*DoStep)(fmi2Component, fmi2Real, fmi2Real, fmi2Boolean);
    void (*FreeInstance)(fmi2Component);
    const long inputs = sizes[1];
    const long outputs = sizes[2];
    const fmi2ValueReference start = (fmi2ValueReference)sizes[3];
    const fmi2Integer given = 2;
    const size_t all = (size_t)(inputs + outputs + sizes[4]);
    fmi2CallbackFunctions none = {NULL, NULL, NULL, NULL, NULL};
    fmi2ValueReference *at = malloc((all + 1) * sizeof(*at));
    fmi2ValueReference *in = at;
    fmi2ValueReference *of = at + inputs;
    fmi2ValueReference *lag = of + outputs;
    fmi2Component c;
    int result = 0;
    long t;
    long k;
    if (library == NULL || at == NULL) {
        return __LINE__;
    }
    if (!OF(Instantiate) || !OF(SetupExperiment) || !OF(EnterInitializationMode) ||
        !OF(ExitInitializationMode) || !OF(SetInteger) || !OF(SetReal) ||
        !OF(GetReal) || !OF(DoStep) || !OF(FreeInstance)) {
        return __LINE__;
    }
    for (k = 0; k < inputs + outputs; k++) {
        at[k] = (fmi2ValueReference)k;
    }
    for (k = 0; k < sizes[4]; k++) {
        lag[k] = start + 1 + (fmi2ValueReference)k;
    }
    c = Instantiate("run", fmi2CoSimulation, token, NULL, &none, fmi2False, fmi2False);
    DO(c == NULL ? fmi2Error : fmi2OK)
    DO(SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0))
    DO(EnterInitializationMode(c))
    DO(SetInteger(c, &start, 1, &given))
    DO(SetReal(c, lag, (size_t)sizes[4], lags))
    DO(SetReal(c, in, (size_t)inputs, u))
    DO(ExitInitializationMode(c))
    for (t = 0; t < sizes[0] && result == 0; t++) {
        DO(SetReal(c, in, (size_t)inputs, &u[t * inputs]))
        DO(DoStep(c, (double)t * step, step, fmi2True))
        DO(GetReal(c, of, (size_t)outputs, &out[t * outputs]))
    }
    FreeInstance(c);
    free(at);
    (void)dlclose(library);
    return result;
}
