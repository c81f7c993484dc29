/* --- Creation and destruction ------------------------------------------------------------------------ */

/* How the host wants an instance. */
typedef struct {
    const char *name, *token, *resources;
    int32_t type; /* 0 for model exchange, 1 for co-simulation, 2 for scheduled execution */
    int logging_on, event_mode_used, early_return_allowed;
    const uint32_t *intermediate_variables;
    size_t n;
    int has_intermediate_update;
} Wishes;

static Instance *instantiate(const Host *host, const char *function, const Wishes *wishes)
{
    const char *const strings[] = {wishes->name, wishes->token, wishes->resources};
    Call call = {block(host, function), function, fmiXError, 0};
    Instance *const instance = call.instance;
    if (!instance)
        return NULL;
    memset(instance, 0, offsetof(Instance, model));
    instance->host = *host;
    instance->model.host = instance;
    MODEL(init)(&instance->model);
    instance->arguments = more_room(&call, ARGUMENTS_SIZE);
    if (enter(&call, space_of_strings(strings, 3) + space(wishes->n, 4))) {
        const uint32_t name = in_string(&call, wishes->name), token = in_string(&call, wishes->token);
        const uint32_t resources = in_string(&call, wishes->resources);
        const uint32_t variables = in_array(&call, wishes->intermediate_variables, wishes->n, 4);
        instance->handle = MODEL(fmu_instantiate)(
            &instance->model, name, token, resources, (uint32_t)wishes->type, (uint32_t)wishes->logging_on,
            (uint32_t)wishes->event_mode_used, (uint32_t)wishes->early_return_allowed, variables,
            (uint32_t)wishes->n, (uint32_t)wishes->has_intermediate_update);
        leave(&call, fmiXOK);
    }
    if (!instance->handle) {
        release_block(instance);
        return NULL;
    }
    return instance;
}

static void free_instance(Instance *instance)
{
    if (!instance)
        return;
    if (instance->model.trap == MODEL_TRAP_NONE)
        MODEL(fmu_free)(&instance->model, instance->handle);
    release_block(instance);
}

