FMI3_Export const char *fmi3GetVersion(void)
{
    return "3.0";
}

FMI3_Export fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                      fmi3Boolean visible, fmi3Boolean logging_on,
                                                      fmi3InstanceEnvironment environment,
                                                      fmi3LogMessageCallback log_message)
{
    const Host host = {environment, log_message, NULL@NOT_SCHEDULED@};
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
    const Host host = {environment, log_message, intermediate_update@NOT_SCHEDULED@};
    const Wishes wishes = {name, token, resources, 1, logging_on, event_mode_used, early_return_allowed,
                           intermediate_variables, n, intermediate_update != NULL};
    (void)visible;
    return instantiate(&host, "fmi3InstantiateCoSimulation", &wishes);
}

