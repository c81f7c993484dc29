#define NO_SCHEDULED_EXECUTION "the FMU is not for scheduled execution; expected model exchange or co-simulation"

/* Passes values of variables. A host may claim to have more values than the variables have elements; only as many are
 * read, and the model refuses the number. */
static inline uint32_t in_values(Call *call, uint32_t references, size_t n, const void *values, size_t n_values,
                                 size_t size)
{
    size_t readable = n_values;
    uint32_t address;
    if (n_values > n) {
        const uint32_t count =
            MODEL(fmu_count_elements)(&call->instance->model, call->instance->handle, references, (uint32_t)n);
        readable = count < n_values ? count : n_values;
    }
    address = in_array(call, values, readable, size);
    if (address)
        call->next += (uint32_t)(space(n_values, size) - space(readable, size));
    return address;
}

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

