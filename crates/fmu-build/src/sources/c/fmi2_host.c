/* --- The host -------------------------------------------------------------------------------------- */

/* What an instance keeps of the arguments of fmi2Instantiate. */
typedef struct {
    fmi2CallbackFunctions callbacks;
    char instance_name[256];
} Host;

/* Sends a message to the logger of the host. The message is an argument of the format, never the format. */
static void send_message(const Host *host, fmi2Status status, const char *category, const char *message)
{
    if (host->callbacks.logger)
        host->callbacks.logger(host->callbacks.componentEnvironment, host->instance_name, status, category, "%s",
                               message);
}

#ifndef FMU_STATIC_INSTANCES
static int host_has_memory(const Host *host)
{
    return host->callbacks.allocateMemory && host->callbacks.freeMemory;
}

static void *allocate(const Host *host, size_t size)
{
    return host_has_memory(host) ? host->callbacks.allocateMemory(1, size) : malloc(size);
}

static void release(const Host *host, void *memory)
{
    if (host_has_memory(host))
        host->callbacks.freeMemory(memory);
    else
        free(memory);
}
#endif

