FMI3_Export fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging_on,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log_message, fmi3ClockUpdateCallback clock_update,
    fmi3LockPreemptionCallback lock_preemption, fmi3UnlockPreemptionCallback unlock_preemption)
{
    const Host host = {environment, log_message, NULL, clock_update, lock_preemption, unlock_preemption, 0};
    const Wishes wishes = {name, token, resources, 2, logging_on, 0, 0, NULL, 0, clock_update != NULL};
    (void)visible;
    return instantiate(&host, "fmi3InstantiateScheduledExecution", &wishes);
}

