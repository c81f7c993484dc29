/* Passes room for what an event has changed. Returns its address. */
static uint32_t in_event_info(Call *call, const fmi2EventInfo *info)
{
    return out_array(call, info, 4, 8);
}

/* Returns what an event has changed. */
static void get_event_info(const Call *call, uint32_t address, fmi2EventInfo *info)
{
    fmi2Boolean flags[5];
    if (!info)
        return;
    get_array(call, address, flags, 5, sizeof *flags);
    info->newDiscreteStatesNeeded = flags[0];
    info->terminateSimulation = flags[1];
    info->nominalsOfContinuousStatesChanged = flags[2];
    info->valuesOfContinuousStatesChanged = flags[3];
    info->nextEventTimeDefined = flags[4];
    get_array(call, address + 24, &info->nextEventTime, 1, sizeof info->nextEventTime);
}

