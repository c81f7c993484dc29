FMI3_Export const char *fmi3GetVersion(void)
{
    return "3.0";
}

FMI3_Export fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                      fmi3Boolean visible, fmi3Boolean logging_on,
                                                      fmi3InstanceEnvironment environment,
                                                      fmi3LogMessageCallback log_message)
{
    const Host host = {environment, log_message, NULL};
    const Wishes wishes = {name, token, resources, 0, logging_on, 0, 0, NULL, 0, 0};
    (void)visible;
    return instantiate(&host, "fmi3InstantiateModelExchange", &wishes);
}

FMI3_Export fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging_on,
    fmi3Boolean event_mode_used, fmi3Boolean early_return_allowed,
    const fmi3ValueReference intermediate_variables[], size_t n, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log_message, fmi3IntermediateUpdateCallback intermediate_update)
{
    const Host host = {environment, log_message, intermediate_update};
    const Wishes wishes = {name, token, resources, 1, logging_on, event_mode_used, early_return_allowed,
                           intermediate_variables, n, intermediate_update != NULL};
    (void)visible;
    return instantiate(&host, "fmi3InstantiateCoSimulation", &wishes);
}

FMI3_Export fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging_on,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log_message, fmi3ClockUpdateCallback clock_update,
    fmi3LockPreemptionCallback lock_preemption, fmi3UnlockPreemptionCallback unlock_preemption)
{
    const Host host = {environment, log_message, NULL};
    (void)name, (void)token, (void)resources, (void)visible, (void)logging_on;
    (void)clock_update, (void)lock_preemption, (void)unlock_preemption;
    log_failure(&host, fmi3Error, "fmi3InstantiateScheduledExecution", NO_SCHEDULED_EXECUTION);
    return NULL;
}

FMI3_Export void fmi3FreeInstance(fmi3Instance instance)
{
    free_instance(instance);
}

