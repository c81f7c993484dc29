/* What the host does differently in FMI 2.0. */

/* Formats every message, so that all its bytes are read. */
static void logger(void *environment, const char *instance, Status status, const char *category,
                   const char *format, ...)
{
    static char text[1 << 16];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    CHECK(environment == &messages && status <= FATAL);
    CHECK(strlen(instance) + strlen(category) + strlen(text) > 0);
    if (status == FATAL)
        printf("[%s] %s\n", category, text);
    ++messages;
}

static const Callbacks callbacks = {logger, NULL, NULL, NULL, &messages};

static Component made_for(int kind, int debug)
{
    Component c = Instantiate("host", kind, guid, "file:///", &callbacks, 0, debug);
    CHECK(c);
    return c;
}

static void enter_initialization(Component c, double time)
{
    EXPECT(OK, SetupExperiment(c, 0, 0.0, time, 0, 0.0));
    EXPECT(OK, EnterInitializationMode(c));
}

static Status do_step(Component c, double time, double step)
{
    return DoStep(c, time, step, 1);
}

static Status set(Component c, const Variable *v)
{
    const int is_real = strchr("ruxd", v->type) != NULL;
    const int number = is_real ? 0 : (int)v->value; /* NaN cannot be converted */
    if (is_real)
        return SetReal(c, &v->reference, 1, &v->value);
    if (v->type == 'i')
        return SetInteger(c, &v->reference, 1, &number);
    return SetBoolean(c, &v->reference, 1, &number);
}

static double get(Component c, const Variable *v)
{
    double *real = malloc(sizeof *real), result;
    int *number = malloc(sizeof *number);
    if (strchr("ruxd", v->type)) {
        EXPECT(OK, GetReal(c, &v->reference, 1, real));
        result = *real;
    } else {
        EXPECT(OK, v->type == 'i' ? GetInteger(c, &v->reference, 1, number)
                                  : GetBoolean(c, &v->reference, 1, number));
        result = *number;
    }
    free(real);
    free(number);
    return result;
}

static double next_event(Component c)
{
    Event event;
    do
        EXPECT(OK, NewDiscreteStates(c, &event));
    while (event.discrete_states_need_update);
    CHECK(!event.terminate);
    return event.next_event_time_defined ? event.next_event_time : INFINITY;
}

static void check_version(Component c)
{
    double time;
    int ended;
    CHECK(!strcmp(GetVersion(), "2.0") && !strcmp(GetTypesPlatform(), "default"));
    EXPECT(OK, GetRealStatus(c, LAST_SUCCESSFUL_TIME, &time));
    EXPECT(OK, GetBooleanStatus(c, TERMINATED, &ended));
    CHECK(fabs(time - 100 * H) < 1e-9 && !ended);
}

static void bad_arguments_in(Component c)
{
    const unsigned unknown = 4000000000u;
    const char *text = "%s%n", *bad[] = {"%s%n", "\xff\xfe", NULL};
    double real = NAN;
    int number = 7;
    State none = NULL;
    EXPECT(ERROR, GetReal(c, &unknown, 1, &real));
    EXPECT(ERROR, GetInteger(c, &unknown, 1, &number));
    EXPECT(ERROR, GetBoolean(c, NULL, 1, &number));
    EXPECT(ERROR, GetString(c, &unknown, 1, &text));
    EXPECT(ERROR, SetReal(c, &unknown, 1, &real));
    EXPECT(ERROR, SetInteger(c, &unknown, 1, NULL));
    EXPECT(ERROR, SetBoolean(c, &unknown, 1, &number));
    EXPECT(ERROR, SetString(c, &unknown, 1, &text));
    EXPECT(ERROR, SetupExperiment(c, 0, 0.0, NAN, 0, 0.0));
    EXPECT(ERROR, SetDebugLogging(c, 1, 1, bad));
    EXPECT(ERROR, SetDebugLogging(c, 1, 3, bad));
    EXPECT(ERROR, SetDebugLogging(c, 1, 1, NULL));
    EXPECT(ERROR, GetFMUstate(c, NULL));
    EXPECT(ERROR, SetFMUstate(c, NULL));
    EXPECT(ERROR, SerializeFMUstate(c, NULL, NULL, 0));
    EXPECT(ERROR, DeSerializeFMUstate(c, NULL, 10, &none));
    EXPECT(ERROR, GetDirectionalDerivative(c, &unknown, 1, &unknown, 1, &real, &real));
    EXPECT(ERROR, SetRealInputDerivatives(c, &unknown, 1, &number, &real));
    EXPECT(ERROR, GetRealOutputDerivatives(c, &unknown, 1, &number, &real));
    EXPECT(ERROR, CancelStep(c));
    EXPECT(ERROR, DoStep(c, NAN, H, 1));
    EXPECT(ERROR, DoStep(c, 0.0, INFINITY, 1));
    EXPECT(ERROR, DoStep(c, 7.0, H, 1));
    EXPECT(ERROR, EnterEventMode(c));
    EXPECT(ERROR, NewDiscreteStates(c, NULL));
    EXPECT(ERROR, EnterContinuousTimeMode(c));
    EXPECT(ERROR, CompletedIntegratorStep(c, 1, NULL, NULL));
    EXPECT(ERROR, SetTime(c, NAN));
    EXPECT(ERROR, SetContinuousStates(c, &real, 1));
    EXPECT(ERROR, GetDerivatives(c, NULL, 1));
    EXPECT(ERROR, GetEventIndicators(c, NULL, 1));
    EXPECT(ERROR, GetContinuousStates(c, NULL, 1));
    EXPECT(ERROR, GetNominalsOfContinuousStates(c, NULL, 1));
}

static void bad_instances(void)
{
    CHECK(!Instantiate("host", CO_SIMULATION, "{no guid}", NULL, &callbacks, 0, 1));
    CHECK(!Instantiate("host", 2, guid, NULL, &callbacks, 0, 1)); /* no type of FMU */
    CHECK(!Instantiate(NULL, CO_SIMULATION, guid, NULL, &callbacks, 0, 1));
    CHECK(!Instantiate("\xff", CO_SIMULATION, guid, NULL, &callbacks, 0, 1));
    CHECK(!Instantiate("host", CO_SIMULATION, NULL, NULL, NULL, 0, 1));
}
