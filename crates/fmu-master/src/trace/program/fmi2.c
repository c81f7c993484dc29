typedef struct {
    int newDiscreteStatesNeeded, terminateSimulation, nominalsOfContinuousStatesChanged;
    int valuesOfContinuousStatesChanged, nextEventTimeDefined;
    double nextEventTime;
} fmi2EventInfo;

typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(void *, int);
    void *componentEnvironment;
} fmi2CallbackFunctions;

static void logger(void *environment, const char *name, int status, const char *category, const char *text, ...) {
    va_list arguments;
    (void) environment;
    printf("    %s (%d, %s): ", name ? name : "", status, category ? category : "");
    va_start(arguments, text);
    vprintf(text ? text : "", arguments);
    va_end(arguments);
    printf("\n");
    fflush(stdout);
}

static const fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};

#define CHECK_INFO(info, time, ...) \
    do { \
        int got[] = {info.newDiscreteStatesNeeded, info.terminateSimulation, \
                     info.nominalsOfContinuousStatesChanged, info.valuesOfContinuousStatesChanged, \
                     info.nextEventTimeDefined}; \
        double next[] = {info.nextEventTime}; \
        CHECK(int, got, __VA_ARGS__); \
        if (got[4]) CHECK(double, next, {time}); \
    } while (0)

/* A resource is found by a URI. */
static void locate(const char *folder) {
    snprintf(resources, sizeof resources, "file://%s%s/resources", folder[0] == '/' ? "" : "/", folder);
}

