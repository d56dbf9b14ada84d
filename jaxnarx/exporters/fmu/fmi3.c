/* FMI 3.0 for co-simulation, with event mode: there the inputs of a sample are set at
 * its time and its outputs are at hand, without delay. A call that is refused changes
 * nothing. */

#define NOT_HERE "this function is not for a model in co-simulation"

typedef struct {
    unit m;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    int events;
} component;

static fmi3Status told(const component *c, fmi3Status status, const char *what)
{
    if (c->log != NULL) {
        c->log(c->environment, status,
               status == fmi3Warning ? "logStatusWarning" : "logStatusError", what);
    }
    return status;
}

static fmi3Status refused(const component *c, const char *why)
{
    return c == NULL ? fmi3Error : told(c, fmi3Error, why);
}

static fmi3Status nothing(const component *c, size_t count)
{
    if (c != NULL && count == 0) {
        return fmi3OK;
    }
    return refused(c, "there are no variables of this type");
}

static int is_in(const component *c, int first, int last)
{
    return c != NULL && c->m.phase >= first && c->m.phase <= last;
}

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn,
                               size_t nCategories, const fmi3String categories[])
{
    (void)loggingOn; /* what is told are errors and warnings */
    (void)nCategories;
    (void)categories;
    return instance == NULL ? fmi3Error : fmi3OK;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName,
                                          fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible,
                                          fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment,
                                          fmi3LogMessageCallback logMessage)
{
    (void)instanceName;
    (void)instantiationToken;
    (void)resourcePath;
    (void)visible;
    (void)loggingOn;
    (void)instanceEnvironment;
    (void)logMessage;
    return NULL;
}

fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
    fmi3Boolean visible, fmi3Boolean loggingOn, fmi3Boolean eventModeUsed,
    fmi3Boolean earlyReturnAllowed,
    const fmi3ValueReference requiredIntermediateVariables[],
    size_t nRequiredIntermediateVariables, fmi3InstanceEnvironment instanceEnvironment,
    fmi3LogMessageCallback logMessage,
    fmi3IntermediateUpdateCallback intermediateUpdate)
{
    component *c = calloc(1, sizeof(*c));
    (void)instanceName;
    (void)resourcePath;
    (void)visible;
    (void)loggingOn;
    (void)earlyReturnAllowed;
    (void)requiredIntermediateVariables;
    (void)nRequiredIntermediateVariables;
    (void)intermediateUpdate;
    if (c == NULL) {
        return NULL;
    }
    c->environment = instanceEnvironment;
    c->log = logMessage;
    c->events = eventModeUsed;
    if (instantiationToken == NULL || strcmp(instantiationToken, TOKEN) != 0) {
        (void)told(c, fmi3Error, "the instantiation token is not that of this model");
        free(c);
        return NULL;
    }
    fmi_unit_reset(&c->m);
    return c;
}

fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
    fmi3Boolean visible, fmi3Boolean loggingOn,
    fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage,
    fmi3ClockUpdateCallback clockUpdate, fmi3LockPreemptionCallback lockPreemption,
    fmi3UnlockPreemptionCallback unlockPreemption)
{
    (void)clockUpdate;
    (void)lockPreemption;
    (void)unlockPreemption;
    return fmi3InstantiateModelExchange(instanceName, instantiationToken, resourcePath,
                                        visible, loggingOn, instanceEnvironment,
                                        logMessage);
}

void fmi3FreeInstance(fmi3Instance instance)
{
    free(instance);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance,
                                       fmi3Boolean toleranceDefined,
                                       fmi3Float64 tolerance, fmi3Float64 startTime,
                                       fmi3Boolean stopTimeDefined,
                                       fmi3Float64 stopTime)
{
    component *own = instance;
    (void)toleranceDefined;
    (void)tolerance;
    if (!is_in(own, CREATED, CREATED)) {
        return refused(own, "initialization comes once, first");
    }
    own->m.start_time = startTime;
    own->m.stops = stopTimeDefined;
    own->m.stop_time = stopTime;
    own->m.phase = STARTING;
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    component *own = instance;
    if (!is_in(own, STARTING, STARTING)) {
        return refused(own, "the instance is not in initialization mode");
    }
    fmi_unit_evaluate(&own->m);
    own->m.phase = own->events ? EVENT : STEPPING;
    if (!own->m.rests) {
        return told(own, fmi3Warning, "there is no steady state at these inputs");
    }
    return fmi3OK;
}

fmi3Status fmi3EnterEventMode(fmi3Instance instance)
{
    component *own = instance;
    if (!is_in(own, STEPPING, STEPPING) || !own->events) {
        return refused(own, "event mode follows step mode, if it is used");
    }
    own->m.phase = EVENT;
    return fmi3OK;
}

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance)
{
    component *own = instance;
    if (!is_in(own, STARTING, EVENT)) {
        return refused(own, "the instance is not in event mode");
    }
    fmi_unit_evaluate(&own->m);
    return fmi3OK;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance,
                                    fmi3Boolean *discreteStatesNeedUpdate,
                                    fmi3Boolean *terminateSimulation,
                                    fmi3Boolean *nominalsOfContinuousStatesChanged,
                                    fmi3Boolean *valuesOfContinuousStatesChanged,
                                    fmi3Boolean *nextEventTimeDefined,
                                    fmi3Float64 *nextEventTime)
{
    component *own = instance;
    if (!is_in(own, EVENT, EVENT)) {
        return refused(own, "the instance is not in event mode");
    }
    fmi_unit_evaluate(&own->m);
    *discreteStatesNeedUpdate = fmi3False;
    *terminateSimulation = fmi3False;
    *nominalsOfContinuousStatesChanged = fmi3False;
    *valuesOfContinuousStatesChanged = fmi3False;
    *nextEventTimeDefined = fmi3True;
    *nextEventTime = fmi_unit_time(&own->m) + UPPER_SAMPLE_TIME;
    return fmi3OK;
}

fmi3Status fmi3EnterStepMode(fmi3Instance instance)
{
    component *own = instance;
    if (!is_in(own, EVENT, EVENT)) {
        return refused(own, "the instance is not in event mode");
    }
    fmi_unit_evaluate(&own->m);
    own->m.phase = STEPPING;
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    component *own = instance;
    if (!is_in(own, EVENT, STEPPING)) {
        return refused(own, "there is nothing to terminate");
    }
    own->m.phase = ENDED;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    if (instance == NULL) {
        return fmi3Error;
    }
    fmi_unit_reset(&((component *)instance)->m);
    return fmi3OK;
}

/* Constant arrays stand behind all other variables. */

static int fmi_is_array(unsigned int at)
{
    return at > FMI_AT_TIME && at - FMI_AT_TIME <= ARRAYS;
}

static size_t fmi_count_of(unsigned int at)
{
#if ARRAYS
    if (fmi_is_array(at)) {
        const unsigned int k = at - FMI_AT_TIME;
        return fmi_array_starts[k] - fmi_array_starts[k - 1u];
    }
#endif
    (void)at;
    return 1;
}

static void fmi_copy_array(unsigned int at, double *to)
{
#if ARRAYS
    const size_t first = fmi_array_starts[at - FMI_AT_TIME - 1u];
    memcpy(to, &fmi_arrays[first], fmi_count_of(at) * sizeof(*to));
#endif
    (void)at;
    (void)to;
}

fmi3Status fmi3GetFloat64(fmi3Instance instance,
                          const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, fmi3Float64 values[], size_t nValues)
{
    component *own = instance;
    size_t place = 0;
    size_t k;
    if (own == NULL) {
        return fmi3Error;
    }
    for (k = 0; k < nValueReferences; k++) {
        place += fmi_count_of(valueReferences[k]);
    }
    if (place != nValues) {
        return refused(own, "fmi3GetFloat64: nValues is not the size of the variables");
    }
    place = 0;
    for (k = 0; k < nValueReferences; k++) {
        const unsigned int at = valueReferences[k];
        if (fmi_is_array(at)) {
            fmi_copy_array(at, &values[place]);
        } else if (!fmi_unit_get_real(&own->m, at, &values[place])) {
            return refused(own, "fmi3GetFloat64: there is no such variable");
        }
        place += fmi_count_of(at);
    }
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance instance,
                          const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, const fmi3Float64 values[],
                          size_t nValues)
{
    component *own = instance;
    size_t k;
    if (own == NULL || nValues != nValueReferences) {
        return refused(own, "fmi3SetFloat64: every variable is one number");
    }
    for (k = 0; k < nValues; k++) {
        if (!fmi_unit_may_set_real(&own->m, valueReferences[k])) {
            return refused(own, "fmi3SetFloat64: no input, nor a parameter that may be "
                                "set now");
        }
    }
    for (k = 0; k < nValues; k++) {
        fmi_unit_set_real(&own->m, valueReferences[k], values[k]);
    }
    return fmi3OK;
}

fmi3Status fmi3GetInt64(fmi3Instance instance,
                        const fmi3ValueReference valueReferences[],
                        size_t nValueReferences, fmi3Int64 values[], size_t nValues)
{
    component *own = instance;
    size_t k;
    if (own == NULL || nValues != nValueReferences) {
        return refused(own, "fmi3GetInt64: every variable is one number");
    }
    for (k = 0; k < nValues; k++) {
        if (valueReferences[k] != FMI_AT_START) {
            return refused(own, "fmi3GetInt64: there is no such enumeration");
        }
        values[k] = own->m.kind;
    }
    return fmi3OK;
}

fmi3Status fmi3SetInt64(fmi3Instance instance,
                        const fmi3ValueReference valueReferences[],
                        size_t nValueReferences, const fmi3Int64 values[],
                        size_t nValues)
{
    component *own = instance;
    size_t k;
    if (own == NULL || nValues != nValueReferences) {
        return refused(own, "fmi3SetInt64: every variable is one number");
    }
    for (k = 0; k < nValues; k++) {
        if (!fmi_unit_set_start(&own->m, valueReferences[k], values[k])) {
            return refused(own, "fmi3SetInt64: no such enumeration, no such value, or "
                                "not now");
        }
    }
    return fmi3OK;
}

fmi3Status fmi3GetBoolean(fmi3Instance instance,
                          const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, fmi3Boolean values[], size_t nValues)
{
    component *own = instance;
    int value = 0;
    size_t k;
    if (own == NULL || nValues != nValueReferences) {
        return refused(own, "fmi3GetBoolean: every variable is one value");
    }
    for (k = 0; k < nValues; k++) {
        if (!fmi_unit_get_limited(&own->m, valueReferences[k], &value)) {
            return refused(own, "fmi3GetBoolean: there is no such variable");
        }
        values[k] = value != 0;
    }
    return fmi3OK;
}

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    component *own = instance;
    if (own == NULL || FMUState == NULL) {
        return refused(own, "fmi3GetFMUState: no place for the state");
    }
    *FMUState = fmi_unit_copy(&own->m, *FMUState);
    return *FMUState == NULL ? refused(own, "no memory for the state") : fmi3OK;
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState)
{
    component *own = instance;
    if (own == NULL || FMUState == NULL) {
        return refused(own, "fmi3SetFMUState: no state");
    }
    (void)fmi_unit_copy(FMUState, &own->m);
    return fmi3OK;
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    if (instance == NULL) {
        return fmi3Error;
    }
    if (FMUState != NULL) {
        free(*FMUState);
        *FMUState = NULL;
    }
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState FMUState,
                                      size_t *size)
{
    (void)FMUState;
    *size = sizeof(kept_unit);
    return instance == NULL ? fmi3Error : fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState,
                                 fmi3Byte serializedState[], size_t size)
{
    if (instance == NULL || FMUState == NULL ||
        !fmi_unit_pack(FMUState, serializedState, size)) {
        return refused(instance, "fmi3SerializeFMUState: no state, or another size");
    }
    return fmi3OK;
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance,
                                   const fmi3Byte serializedState[], size_t size,
                                   fmi3FMUState *FMUState)
{
    unit m;
    if (instance == NULL || FMUState == NULL ||
        !fmi_unit_unpack(&m, serializedState, size)) {
        return refused(instance, "fmi3DeserializeFMUState: not a state of this model");
    }
    *FMUState = fmi_unit_copy(&m, *FMUState);
    return *FMUState == NULL ? refused(instance, "no memory for the state") : fmi3OK;
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance,
                                        const fmi3ValueReference unknowns[],
                                        size_t nUnknowns,
                                        const fmi3ValueReference knowns[],
                                        size_t nKnowns, const fmi3Float64 seed[],
                                        size_t nSeed, fmi3Float64 sensitivity[],
                                        size_t nSensitivity)
{
    component *own = instance;
    if (own == NULL || nSeed != nKnowns || nSensitivity != nUnknowns ||
        !fmi_unit_derivative(&own->m, unknowns, nUnknowns, knowns, nKnowns, seed,
                             sensitivity, 0)) {
        return refused(own, "fmi3GetDirectionalDerivative: outputs by inputs and past "
                            "outputs only");
    }
    return fmi3OK;
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance,
                                    const fmi3ValueReference unknowns[],
                                    size_t nUnknowns, const fmi3ValueReference knowns[],
                                    size_t nKnowns, const fmi3Float64 seed[],
                                    size_t nSeed, fmi3Float64 sensitivity[],
                                    size_t nSensitivity)
{
    component *own = instance;
    if (own == NULL || nSeed != nUnknowns || nSensitivity != nKnowns ||
        !fmi_unit_derivative(&own->m, unknowns, nUnknowns, knowns, nKnowns, seed,
                             sensitivity, 1)) {
        return refused(own, "fmi3GetAdjointDerivative: outputs by inputs and past "
                            "outputs only");
    }
    return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint,
                      fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                      fmi3Boolean *eventHandlingNeeded,
                      fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn,
                      fmi3Float64 *lastSuccessfulTime)
{
    component *own = instance;
    int64_t steps;
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!is_in(own, STEPPING, STEPPING)) {
        return refused(own, "fmi3DoStep belongs into step mode");
    }
    steps = fmi_unit_fits(&own->m, currentCommunicationPoint, communicationStepSize);
    if (steps == 0) {
        return refused(own, "fmi3DoStep: a step begins where the last has ended and is "
                            "a multiple of the sample time, up to the stop time");
    }
    fmi_unit_take(&own->m, steps);
    *eventHandlingNeeded = own->events != 0; /* a sample is due */
    *terminateSimulation = fmi3False;
    *earlyReturn = fmi3False;
    *lastSuccessfulTime = fmi_unit_time(&own->m);
    return fmi3OK;
}

