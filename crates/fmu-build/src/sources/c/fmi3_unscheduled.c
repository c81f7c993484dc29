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

