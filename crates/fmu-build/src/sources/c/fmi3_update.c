/* --- Intermediate updates ----------------------------------------------------------------------------- */

/* The model lets the host see a step. Returns whether the host requests an early return. */
uint32_t MODEL(import_intermediate_update)(Model *model, double time, uint32_t set_requested, uint32_t get_allowed,
                                           uint32_t step_finished, uint32_t can_return_early,
                                           uint32_t early_return_time)
{
    Instance *const instance = model->host;
    const char *const function = instance->function;
    fmi3Boolean is_requested = false;
    fmi3Float64 end = model_load_f64(model, early_return_time);
    uint8_t arguments[ARGUMENTS_SIZE]; /* of the step, in whose room the calls of the host have theirs */
    memcpy(arguments, model->memory + instance->arguments, sizeof arguments);
    instance->host.intermediate_update(instance->host.environment, time, set_requested != 0, get_allowed != 0,
                                       step_finished != 0, can_return_early != 0, &is_requested, &end);
    memcpy(model->memory + instance->arguments, arguments, sizeof arguments);
    instance->function = function;
    model_store_f64(model, early_return_time, end);
    return is_requested;
}

