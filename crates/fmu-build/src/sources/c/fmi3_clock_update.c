/* The model has news about clocks, of which the host asks in the callback. */
void MODEL(import_clock_update)(Model *model)
{
    Instance *const instance = model->host;
    Call call = {instance, instance->function, fmi3OK, 0};
    uint8_t arguments[ARGUMENTS_SIZE]; /* of the activation, in whose room the calls of the host have theirs */
    memcpy(arguments, model->memory + instance->arguments, sizeof arguments);
    unlock(instance);
    instance->host.clock_update(instance->host.environment);
    lock(&call);
    memcpy(model->memory + instance->arguments, arguments, sizeof arguments);
    instance->function = call.function;
}

