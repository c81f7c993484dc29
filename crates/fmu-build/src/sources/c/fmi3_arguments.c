#define NO_SCHEDULED_EXECUTION "the FMU is not for scheduled execution; expected model exchange or co-simulation"

/* Passes sizes, which the model has in 32 bits. */
static uint32_t in_sizes(Call *call, const size_t sizes[], size_t n)
{
    const uint32_t address = out_array(call, sizes, n, 4);
    size_t k;
    for (k = 0; sizes && k < n; ++k)
        model_store_u32(&call->instance->model, address + 4 * (uint32_t)k, (uint32_t)sizes[k]);
    return address;
}

/* The size of binary values with the array of their addresses. */
static size_t space_of_binaries(const size_t sizes[], const fmi3Binary values[], size_t n)
{
    size_t sum = space(n, 4), k;
    for (k = 0; sizes && values && sum < MODEL_MEMORY_SIZE && k < n; ++k)
        sum += space(sizes[k], 1);
    return sum;
}

static uint32_t in_binaries(Call *call, const size_t sizes[], const fmi3Binary values[], size_t n)
{
    const uint32_t address = out_array(call, values, n, 4);
    size_t k;
    for (k = 0; sizes && values && k < n; ++k)
        model_store_u32(&call->instance->model, address + 4 * (uint32_t)k, in_array(call, values[k], sizes[k], 1));
    return address;
}

/* Returns binary values, which are in the memory of the model until its next call. */
static void get_binaries(const Call *call, uint32_t address, fmi3Binary values[], size_t n)
{
    Model *const model = &call->instance->model;
    size_t k;
    for (k = 0; values && k < n; ++k)
        values[k] = model_bytes(model, model_load_u32(model, address + 4 * (uint32_t)k), 0);
}

