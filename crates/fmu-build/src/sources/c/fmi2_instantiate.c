FMI2_Export const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

FMI2_Export const char *fmi2GetVersion(void)
{
    return "2.0";
}

FMI2_Export fmi2Component fmi2Instantiate(fmi2String name, fmi2Type kind, fmi2String guid, fmi2String resources,
                                          const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                                          fmi2Boolean logging_on)
{
    const Wishes wishes = {name, guid, resources, (int32_t)kind, logging_on != 0, 0, 0, NULL, 0, 0};
    Host host;
    (void)visible;
    memset(&host, 0, sizeof host);
    if (functions)
        host.callbacks = *functions;
    if (name)
        strncpy(host.instance_name, name, sizeof host.instance_name - 1);
    return instantiate(&host, "fmi2Instantiate", &wishes);
}

FMI2_Export void fmi2FreeInstance(fmi2Component instance)
{
    free_instance(instance);
}

