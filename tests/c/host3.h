/* What the host does differently in FMI 3.0. */

static void logger(void *environment, Status status, const char *category, const char *message)
{
    CHECK(environment == &messages && status <= FATAL);
    CHECK(strlen(category) + strlen(message) > 0);
    if (status == FATAL)
        printf("[%s] %s\n", category, message);
    ++messages;
}

static Component made_for(int kind, int debug)
{
    Component c = kind == MODEL_EXCHANGE
        ? InstantiateModelExchange("host", guid, NULL, false, debug, &messages, logger)
        : InstantiateCoSimulation("host", guid, NULL, false, debug, false, false, NULL, 0, &messages,
                                  logger, NULL);
    CHECK(c);
    return c;
}

static void enter_initialization(Component c, double time)
{
    EXPECT(OK, EnterInitializationMode(c, false, 0.0, time, false, 0.0));
}

static Status do_step(Component c, double time, double step)
{
    bool event, terminate, early;
    double reached;
    const Status status = DoStep(c, time, step, true, &event, &terminate, &early, &reached);
    if (status == OK) {
        CHECK(!event && !terminate && !early);
        CHECK(fabs(reached - time - step) <= 1e-9 * step);
    }
    return status;
}

static Status set(Component c, const Variable *v)
{
    const unsigned *r = &v->reference;
    double reals[LONGEST];
    int64_t integers[LONGEST];
    unsigned char flags[LONGEST]; /* a host may write any byte into a Boolean */
    for (size_t i = 0; i < v->size; ++i) {
        reals[i] = v->value;
        integers[i] = isfinite(v->value) ? (int64_t)v->value : 0;
        flags[i] = (unsigned char)integers[i];
    }
    const uint64_t number = (uint64_t)integers[0];
    const char *text = isnan(v->value) ? "\xff" : "%s%n";
    const size_t length = 3;
    const unsigned char *data = isnan(v->value) ? NULL : (const unsigned char *)"\0\xff";
    switch (v->type) {
    case 'i': return SetInt64(c, r, 1, integers, v->size);
    case 'b': return SetBoolean(c, r, 1, (const bool *)flags, v->size);
    case 'n': return SetUInt64(c, r, 1, &number, 1);
    case 't': return SetString(c, r, 1, &text, 1);
    case 'y': return SetBinary(c, r, 1, &length, &data, 1);
    default: return SetFloat64(c, r, 1, reals, v->size);
    }
}

static double get(Component c, const Variable *v)
{
    const unsigned *r = &v->reference;
    void *values = malloc(v->size * 8);
    const void *data = NULL;
    size_t length = 0;
    double sum = 0;
    switch (v->type) {
    case 'i': EXPECT(OK, GetInt64(c, r, 1, values, v->size)); break;
    case 'b': EXPECT(OK, GetBoolean(c, r, 1, values, v->size)); break;
    case 'n': EXPECT(OK, GetUInt64(c, r, 1, values, 1)); break;
    case 't':
        EXPECT(OK, GetString(c, r, 1, (Text *)&data, 1));
        length = strlen(data);
        break;
    case 'y': EXPECT(OK, GetBinary(c, r, 1, &length, (const unsigned char **)&data, 1)); break;
    default: EXPECT(OK, GetFloat64(c, r, 1, values, v->size));
    }
    for (size_t i = 0; i < v->size; ++i)
        switch (v->type) {
        case 'i': sum += (double)((int64_t *)values)[i]; break;
        case 'b': sum += ((bool *)values)[i]; break;
        case 'n': sum += (double)((uint64_t *)values)[i]; break;
        case 't': case 'y': break;
        default: sum += ((double *)values)[i];
        }
    for (size_t i = 0; i < length; ++i)
        sum += ((const unsigned char *)data)[i];
    free(values);
    return sum;
}

static double next_event(Component c)
{
    bool again, terminate, nominals, states, defined;
    double time;
    do {
        EXPECT(OK, UpdateDiscreteStates(c, &again, &terminate, &nominals, &states, &defined, &time));
        CHECK(!terminate);
    } while (again);
    return defined ? time : INFINITY;
}

static void check_version(Component c)
{
    CHECK(!strcmp(GetVersion(), "3.0"));
    EXPECT(OK, DoStep(c, 100 * H, H, true, NULL, NULL, NULL, NULL)); /* some hosts do that */
}

#define REFUSE(name, type)                                                                        \
    do {                                                                                          \
        type value = 0;                                                                           \
        EXPECT(ERROR, Get##name(c, &unknown, 1, &value, 1));                                      \
        EXPECT(ERROR, Set##name(c, &unknown, 1, &value, 1));                                      \
        EXPECT(ERROR, Get##name(c, NULL, 1, &value, 1));                                          \
        EXPECT(ERROR, Set##name(c, &unknown, 1, NULL, 1));                                        \
    } while (0)

static void bad_arguments_in(Component c)
{
    const unsigned unknown = 4000000000u;
    const char *bad[] = {"%s%n", "\xff\xfe", NULL};
    const unsigned char *bytes = NULL;
    const int32_t order = 7;
    size_t size = 1;
    double real = NAN;
    bool flag = false;
    State none = NULL;
    REFUSE(Float32, float);
    REFUSE(Float64, double);
    REFUSE(Int8, int8_t);
    REFUSE(UInt8, uint8_t);
    REFUSE(Int16, int16_t);
    REFUSE(UInt16, uint16_t);
    REFUSE(Int32, int32_t);
    REFUSE(UInt32, uint32_t);
    REFUSE(Int64, int64_t);
    REFUSE(UInt64, uint64_t);
    REFUSE(Boolean, bool);
    REFUSE(String, Text);
    EXPECT(ERROR, GetBinary(c, &unknown, 1, &size, &bytes, 1));
    EXPECT(ERROR, SetBinary(c, &unknown, 1, NULL, NULL, 1));
    EXPECT(ERROR, GetClock(c, &unknown, 1, &flag));
    EXPECT(ERROR, SetClock(c, &unknown, 1, NULL));
    for (size_t k = 0; k < count; ++k) {
        const Variable *v = &variables[k];
        double values[LONGEST + 1] = {0};
        EXPECT(ERROR, GetFloat32(c, &v->reference, 1, (float *)values, 1));
        if (v->type == 'r') {
            EXPECT(ERROR, GetFloat64(c, &v->reference, 1, values, v->size + 1));
            EXPECT(ERROR, GetFloat64(c, &v->reference, 1, values, v->size - 1));
            EXPECT(ERROR, SetFloat64(c, &v->reference, 1, values, v->size + 1));
        }
    }
    EXPECT(ERROR, GetNumberOfVariableDependencies(c, unknown, &size));
    EXPECT(ERROR, EnterInitializationMode(c, false, 0.0, 0.0, true, -1.0));
    EXPECT(ERROR, EnterInitializationMode(c, false, 0.0, NAN, false, 0.0));
    EXPECT(ERROR, SetDebugLogging(c, true, 1, bad));
    EXPECT(ERROR, SetDebugLogging(c, true, 3, bad));
    EXPECT(ERROR, SetDebugLogging(c, true, 1, NULL));
    EXPECT(ERROR, GetFMUState(c, NULL));
    EXPECT(ERROR, SetFMUState(c, NULL));
    EXPECT(ERROR, SerializeFMUState(c, NULL, NULL, 0));
    EXPECT(ERROR, DeserializeFMUState(c, NULL, 10, &none));
    EXPECT(ERROR, GetDirectionalDerivative(c, &unknown, 1, &unknown, 1, &real, 1, &real, 1));
    EXPECT(ERROR, GetAdjointDerivative(c, &unknown, 1, &unknown, 1, &real, 1, &real, 1));
    EXPECT(ERROR, GetOutputDerivatives(c, &unknown, 1, &order, &real, 1));
    EXPECT(ERROR, ExitConfigurationMode(c));
    EXPECT(ERROR, EvaluateDiscreteStates(c));
    EXPECT(ERROR, UpdateDiscreteStates(c, NULL, NULL, NULL, NULL, NULL, NULL));
    EXPECT(ERROR, EnterEventMode(c));
    EXPECT(ERROR, EnterStepMode(c));
    EXPECT(ERROR, EnterContinuousTimeMode(c));
    EXPECT(ERROR, CompletedIntegratorStep(c, true, NULL, NULL));
    EXPECT(ERROR, SetTime(c, NAN));
    EXPECT(ERROR, SetContinuousStates(c, &real, 1));
    EXPECT(ERROR, GetContinuousStateDerivatives(c, NULL, 1));
    EXPECT(ERROR, GetEventIndicators(c, NULL, 1));
    EXPECT(ERROR, GetContinuousStates(c, NULL, 1));
    EXPECT(ERROR, GetNominalsOfContinuousStates(c, NULL, 1));
    EXPECT(ERROR, GetNumberOfContinuousStates(c, NULL));
    EXPECT(ERROR, GetNumberOfEventIndicators(c, NULL));
    EXPECT(ERROR, DoStep(c, NAN, H, true, &flag, &flag, &flag, &real));
    EXPECT(ERROR, DoStep(c, 0.0, INFINITY, true, &flag, &flag, &flag, &real));
    EXPECT(ERROR, DoStep(c, 7.0, H, true, &flag, &flag, &flag, &real));
    EXPECT(ERROR, ActivateModelPartition(c, unknown, 0.0));
}

static Component instantiate(const char *name, const char *token, fmi3LogMessageCallback log)
{
    return InstantiateCoSimulation(name, token, NULL, false, true, false, false, NULL, 0, &messages,
                                   log, NULL);
}

static void bad_instances(void)
{
    CHECK(!instantiate("host", "{no token}", logger) && !instantiate("host", NULL, logger));
    CHECK(!instantiate(NULL, guid, logger) && !instantiate("\xff", guid, logger));
    CHECK(!InstantiateCoSimulation("host", guid, NULL, false, true, false, false, NULL, 1, &messages,
                                   logger, NULL));
    CHECK(!InstantiateModelExchange("host", "", "\xff", false, true, &messages, logger));
    CHECK(!InstantiateScheduledExecution("host", guid, NULL, false, true, &messages, logger, NULL, NULL,
                                         NULL));
    Component c = instantiate("host", guid, NULL); /* no logger */
    bad_arguments_in(c);
    FreeInstance(c);
}

typedef struct {
    unsigned items[MOST];
    size_t size;
} List;

static List of_type(char type)
{
    List list = {{0}, 0};
    for (size_t k = 0; k < count; ++k)
        if (variables[k].type == type)
            list.items[list.size++] = variables[k].reference;
    return list;
}

static Component updated;
static unsigned updates;

/* Reads the states within a step, and ends every third step early. */
static void update(void *environment, double time, bool set_requested, bool get_allowed, bool finished,
                   bool can_return, bool *return_early, double *return_time)
{
    CHECK(environment == &messages && isfinite(time));
    for (size_t k = 0; k < count; ++k) {
        const Variable *v = &variables[k];
        if (v->type == 'x' && get_allowed)
            CHECK(isfinite(get(updated, v)));
        if (v->type == 'u' && set_requested)
            EXPECT(OK, set(updated, v));
    }
    EXPECT(ERROR, EnterEventMode(updated));
    *return_early = can_return && finished && ++updates % 3 == 0;
    *return_time = time;
}

/* Co-simulation with event mode, early return and intermediate updates. */
static void events(void)
{
    List required = of_type('x');
    const List inputs = of_type('u');
    memcpy(required.items + required.size, inputs.items, inputs.size * sizeof *inputs.items);
    required.size += inputs.size;
    updated = InstantiateCoSimulation("host", guid, NULL, false, false, true, true, required.items,
                                      required.size, &messages, logger, update);
    CHECK(updated);
    set_all(updated);
    initialize(updated, 0.0);
    bool event = true, terminate, early;
    double time = 0;
    unsigned calls = 0;
    for (; time < 100 * H; ++calls) {
        if (event && calls)
            EXPECT(OK, EnterEventMode(updated));
        if (event) {
            next_event(updated);
            get_all(updated);
            EXPECT(OK, EnterStepMode(updated));
        }
        const double before = time;
        EXPECT(OK, DoStep(updated, time, 2.5 * H, true, &event, &terminate, &early, &time));
        CHECK(!terminate && time > before && time < before + 2.6 * H);
        CHECK(early || fabs(time - before - 2.5 * H) < 1e-9);
    }
    CHECK(calls > 40);
    EXPECT(OK, Terminate(updated));
    FreeInstance(updated);
}

/* The columns and the rows belong to the same matrix. */
static void matrix(Component c, const List *unknowns, const List *knowns)
{
    const size_t n = unknowns->size, m = knowns->size;
    const References of = unknowns->items, by = knowns->items;
    double *column = malloc(n * sizeof *column), *row = malloc(m * sizeof *row);
    CHECK(n && m);
    for (size_t i = 0; i < n; ++i)
        for (size_t j = 0; j < m; ++j) {
            double unit_row[MOST] = {0}, unit_column[MOST] = {0};
            unit_row[j] = unit_column[i] = 1;
            EXPECT(OK, GetDirectionalDerivative(c, of, n, by, m, unit_row, m, column, n));
            EXPECT(OK, GetAdjointDerivative(c, of, n, by, m, unit_column, n, row, m));
            CHECK(column[i] == row[j]);
        }
    EXPECT(ERROR, GetDirectionalDerivative(c, of, n, by, m, row, m - 1, column, n));
    EXPECT(ERROR, GetAdjointDerivative(c, of, n, by, m, column, n, row, m + 1));
    free(column);
    free(row);
}

static void derivatives(void)
{
    const List inputs = of_type('u'), states = of_type('x'), slopes = of_type('d');
    const int32_t orders[MOST] = {1, 1, 1, 1};
    double outputs[4] = {NAN, NAN, NAN, NAN};
    Component c = made(0);
    set_all(c);
    initialize(c, 0.0);
    steps(c, 0, 10);
    matrix(c, &states, &inputs);
    EXPECT(OK, GetOutputDerivatives(c, states.items, 4, orders, outputs, 4));
    for (size_t i = 0; i < 4; ++i)
        CHECK(isfinite(outputs[i]));
    FreeInstance(c);
    c = made_for(MODEL_EXCHANGE, 0);
    initialize(c, 0.0);
    next_event(c);
    EXPECT(OK, EnterContinuousTimeMode(c));
    matrix(c, &slopes, &states);
    size_t number;
    EXPECT(OK, GetNumberOfContinuousStates(c, &number));
    CHECK(number == states.size);
    EXPECT(OK, GetNumberOfEventIndicators(c, &number));
    CHECK(number == 0);
    FreeInstance(c);
}

/* Changes the size of all arrays. */
static void resize(Component c, const Variable *sizes, size_t size)
{
    Variable changed = *sizes;
    changed.value = (double)size;
    EXPECT(OK, EnterConfigurationMode(c));
    EXPECT(OK, set(c, &changed));
    EXPECT(OK, ExitConfigurationMode(c));
    for (size_t k = 0; k < count; ++k)
        if (variables[k].size > 1)
            variables[k].size = size;
}

static void sizes(void)
{
    const Variable *sizes = NULL;
    for (size_t k = 0; k < count; ++k)
        if (variables[k].type == 'n')
            sizes = &variables[k];
    CHECK(sizes && sizes->settable);
    Component c = made(0), other = made(0);
    State state = NULL;
    size_t size;
    EXPECT(ERROR, set(c, sizes));
    EXPECT(OK, EnterConfigurationMode(c));
    bad_values_in(c, 0);
    EXPECT(OK, ExitConfigurationMode(c));
    resize(c, sizes, (size_t)sizes->value);
    bad_arguments_in(c);
    set_all(c);
    initialize(c, 0.0);
    steps(c, 0, 20);
    resize(c, sizes, LONGEST);
    steps(c, 20, 40);
    EXPECT(OK, GetFMUState(c, &state));
    Byte *bytes = serialized(c, state, &size);
    const double end = get_all(c);
    EXPECT(OK, FreeFMUState(c, &state));
    FreeInstance(c);
    EXPECT(OK, DeserializeFMUState(other, bytes, size, &state));
    EXPECT(OK, SetFMUState(other, state));
    CHECK(get_all(other) == end);
    EXPECT(OK, FreeFMUState(other, &state));
    free(bytes);
    resize(other, sizes, 2);
    steps(other, 40, 60);
    get_all(other);
    FreeInstance(other);
}
