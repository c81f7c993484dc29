/* --- Scheduled execution ----------------------------------------------------------------------------- */

/* Begins a call that the host may preempt by another one. Returns whether no other call uses the instance. */
static int lock(Call *call)
{
    Instance *const instance = call->instance;
    if (!instance)
        return 0;
    if (instance->host.lock_preemption)
        instance->host.lock_preemption();
    if (!instance->host.is_in_use) {
        instance->host.is_in_use = 1;
        return 1;
    }
    log_failure(&instance->host, fmi3Error, call->function,
                "another call uses the instance; expected no call between lockPreemption and unlockPreemption");
    if (instance->host.unlock_preemption)
        instance->host.unlock_preemption();
    return 0;
}

static void unlock(Instance *instance)
{
    instance->host.is_in_use = 0;
    if (instance->host.unlock_preemption)
        instance->host.unlock_preemption();
}

