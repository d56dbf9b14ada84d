/* FMI 2.0 for co-simulation. A call that is refused changes nothing. */

typedef struct {
    unit m;
    fmi2CallbackFunctions callbacks;
    char *name;
} component;

/* The texts are formats without anything to fill in. */
static fmi2Status told(const component *c, fmi2Status status, const char *what)
{
    if (c->callbacks.logger != NULL) {
        const char *category =
            status == fmi2Warning ? "logStatusWarning" : "logStatusError";
        c->callbacks.logger(c->callbacks.componentEnvironment, c->name, status,
                            category, what);
    }
    return status;
}

static fmi2Status refused(const component *c, const char *why)
{
    return c == NULL ? fmi2Error : told(c, fmi2Error, why);
}

static int is_in(const component *c, int first, int last)
{
    return c != NULL && c->m.phase >= first && c->m.phase <= last;
}

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn,
                               size_t nCategories, const fmi2String categories[])
{
    (void)loggingOn; /* what is told are errors and warnings */
    (void)nCategories;
    (void)categories;
    return c == NULL ? fmi2Error : fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType,
                              fmi2String fmuGUID, fmi2String fmuResourceLocation,
                              const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn)
{
    const char *name = instanceName == NULL ? "" : instanceName;
    component *c = calloc(1, sizeof(*c));
    (void)fmuResourceLocation;
    (void)visible;
    (void)loggingOn;
    if (c == NULL) {
        return NULL;
    }
    if (functions != NULL) {
        c->callbacks = *functions;
    }
    c->name = calloc(strlen(name) + 1, 1);
    if (c->name == NULL) {
        free(c);
        return NULL;
    }
    memcpy(c->name, name, strlen(name) + 1);
    if (fmuType != fmi2CoSimulation) {
        (void)told(c, fmi2Error, "there is co-simulation only");
    } else if (fmuGUID == NULL || strcmp(fmuGUID, TOKEN) != 0) {
        (void)told(c, fmi2Error, "the GUID is not that of this model");
    } else {
        fmi_unit_reset(&c->m);
        return c;
    }
    fmi2FreeInstance(c);
    return NULL;
}

void fmi2FreeInstance(fmi2Component c)
{
    if (c != NULL) {
        free(((component *)c)->name);
        free(c);
    }
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined,
                               fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    component *own = c;
    (void)toleranceDefined;
    (void)tolerance;
    if (!is_in(own, CREATED, CREATED)) {
        return refused(own, "fmi2SetupExperiment belongs before initialization");
    }
    own->m.start_time = startTime;
    own->m.stops = stopTimeDefined != fmi2False;
    own->m.stop_time = stopTime;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    component *own = c;
    if (!is_in(own, CREATED, CREATED)) {
        return refused(own, "initialization comes once, first");
    }
    own->m.phase = STARTING;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    component *own = c;
    if (!is_in(own, STARTING, STARTING)) {
        return refused(own, "the instance is not in initialization mode");
    }
    fmi_unit_evaluate(&own->m);
    own->m.phase = STEPPING;
    if (!own->m.rests) {
        return told(own, fmi2Warning, "there is no steady state at these inputs");
    }
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    component *own = c;
    if (!is_in(own, STEPPING, STEPPING)) {
        return refused(own, "there is nothing to terminate");
    }
    own->m.phase = ENDED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    if (c == NULL) {
        return fmi2Error;
    }
    fmi_unit_reset(&((component *)c)->m);
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                       fmi2Real value[])
{
    component *own = c;
    size_t k;
    for (k = 0; own != NULL && k < nvr; k++) {
        if (!fmi_unit_get_real(&own->m, vr[k], &value[k])) {
            return refused(own, "fmi2GetReal: there is no such real variable");
        }
    }
    return own == NULL ? fmi2Error : fmi2OK;
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          fmi2Integer value[])
{
    component *own = c;
    size_t k;
    for (k = 0; own != NULL && k < nvr; k++) {
        if (vr[k] != FMI_AT_START) {
            return refused(own, "fmi2GetInteger: there is no such enumeration");
        }
        value[k] = own->m.kind;
    }
    return own == NULL ? fmi2Error : fmi2OK;
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          fmi2Boolean value[])
{
    component *own = c;
    size_t k;
    for (k = 0; own != NULL && k < nvr; k++) {
        if (!fmi_unit_get_limited(&own->m, vr[k], &value[k])) {
            return refused(own, "fmi2GetBoolean: there is no such Boolean variable");
        }
    }
    return own == NULL ? fmi2Error : fmi2OK;
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                         fmi2String value[])
{
    (void)vr;
    (void)value;
    return nvr == 0 ? fmi2OK : refused(c, "there are no strings");
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                       const fmi2Real value[])
{
    component *own = c;
    size_t k;
    for (k = 0; own != NULL && k < nvr; k++) {
        if (!fmi_unit_may_set_real(&own->m, vr[k])) {
            return refused(own, "fmi2SetReal: no input, nor a parameter that may be "
                                "set now");
        }
    }
    for (k = 0; own != NULL && k < nvr; k++) {
        fmi_unit_set_real(&own->m, vr[k], value[k]);
    }
    return own == NULL ? fmi2Error : fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          const fmi2Integer value[])
{
    component *own = c;
    size_t k;
    for (k = 0; own != NULL && k < nvr; k++) {
        if (!fmi_unit_set_start(&own->m, vr[k], value[k])) {
            return refused(own, "fmi2SetInteger: no such enumeration, no such value, "
                                "or not now");
        }
    }
    return own == NULL ? fmi2Error : fmi2OK;
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          const fmi2Boolean value[])
{
    (void)vr;
    (void)value;
    return nvr == 0 ? fmi2OK : refused(c, "there are no Booleans to be set");
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                         const fmi2String value[])
{
    (void)vr;
    (void)value;
    return nvr == 0 ? fmi2OK : refused(c, "there are no strings");
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    component *own = c;
    if (own == NULL || state == NULL) {
        return refused(own, "fmi2GetFMUstate: no place for the state");
    }
    *state = fmi_unit_copy(&own->m, *state);
    return *state == NULL ? refused(own, "no memory for the state") : fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    component *own = c;
    if (own == NULL || state == NULL) {
        return refused(own, "fmi2SetFMUstate: no state");
    }
    (void)fmi_unit_copy(state, &own->m);
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (c == NULL) {
        return fmi2Error;
    }
    if (state != NULL) {
        free(*state);
        *state = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)state;
    *size = sizeof(kept_unit);
    return c == NULL ? fmi2Error : fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state,
                                 fmi2Byte serialized[], size_t size)
{
    if (c == NULL || state == NULL || !fmi_unit_pack(state, serialized, size)) {
        return refused(c, "fmi2SerializeFMUstate: no state, or another size");
    }
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serialized[],
                                   size_t size, fmi2FMUstate *state)
{
    unit m;
    if (c == NULL || state == NULL || !fmi_unit_unpack(&m, serialized, size)) {
        return refused(c, "fmi2DeSerializeFMUstate: not a state of this model");
    }
    *state = fmi_unit_copy(&m, *state);
    return *state == NULL ? refused(c, "no memory for the state") : fmi2OK;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c,
                                        const fmi2ValueReference vUnknown_ref[],
                                        size_t nUnknown,
                                        const fmi2ValueReference vKnown_ref[],
                                        size_t nKnown, const fmi2Real dvKnown[],
                                        fmi2Real dvUnknown[])
{
    component *own = c;
    if (own == NULL || !fmi_unit_derivative(&own->m, vUnknown_ref, nUnknown, vKnown_ref,
                                            nKnown, dvKnown, dvUnknown, 0)) {
        return refused(own, "fmi2GetDirectionalDerivative: outputs by inputs and past "
                            "outputs only");
    }
    return fmi2OK;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[],
                                       size_t nvr, const fmi2Integer order[],
                                       const fmi2Real value[])
{
    (void)vr;
    (void)nvr;
    (void)order;
    (void)value;
    return refused(c, "inputs are held, not interpolated");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[],
                                        size_t nvr, const fmi2Integer order[],
                                        fmi2Real value[])
{
    (void)vr;
    (void)nvr;
    (void)order;
    (void)value;
    return refused(c, "outputs are discrete: they have no derivatives by time");
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint,
                      fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    component *own = c;
    int64_t steps;
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!is_in(own, STEPPING, STEPPING)) {
        return refused(own, "fmi2DoStep belongs behind initialization");
    }
    steps = fmi_unit_fits(&own->m, currentCommunicationPoint, communicationStepSize);
    if (steps == 0) {
        return refused(own, "fmi2DoStep: a step begins where the last has ended and is "
                            "a multiple of the sample time, up to the stop time");
    }
    fmi_unit_take(&own->m, steps);
    return fmi2OK;
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return refused(c, "no step is under way");
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value)
{
    (void)c;
    (void)s;
    (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    if (c == NULL || s != fmi2LastSuccessfulTime) {
        return fmi2Discard;
    }
    *value = fmi_unit_time(&((component *)c)->m);
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s,
                                fmi2Integer *value)
{
    (void)c;
    (void)s;
    (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s,
                                fmi2Boolean *value)
{
    if (c == NULL || s != fmi2Terminated) {
        return fmi2Discard;
    }
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s,
                               fmi2String *value)
{
    (void)c;
    (void)s;
    (void)value;
    return fmi2Discard;
}
