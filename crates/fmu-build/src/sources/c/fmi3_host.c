/* --- The host -------------------------------------------------------------------------------------- */

/* What an instance keeps of the arguments of fmi3Instantiate*. */
typedef struct {
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log_message;
    fmi3IntermediateUpdateCallback intermediate_update;
@SCHEDULED@} Host;

/* Sends a message to the logger of the host. */
static void send_message(const Host *host, fmi3Status status, const char *category, const char *message)
{
    if (host->log_message)
        host->log_message(host->environment, status, category, message);
}

#ifndef FMU_STATIC_INSTANCES
static void *allocate(const Host *host, size_t size)
{
    (void)host;
    return malloc(size);
}

static void release(const Host *host, void *memory)
{
    (void)host;
    free(memory);
}
#endif

