/* A stand-in for a translated model, for the tests of the interface: four variables of type Float64, a String, and value
 * references that make it fail. Generated text defines the functions that are not here, which refuse the call. */
#include "model.h"

enum { OK = 0, ERROR = 3, FATAL = 4 };
enum { TEXT = 64, HANDLE = 512, STATE = 600, VARIABLES = 704, MORE = 2048, ARGUMENTS = 8192 };
enum { COUNT = 4, OUT_OF_BOUNDS = 8, PANIC = 9 };

static uint32_t log_text(Model *m, uint32_t status, const char *text)
{
    strcpy((char *)m->memory + TEXT, status == FATAL ? "logStatusFatal" : "logStatusError");
    strcpy((char *)m->memory + TEXT + 32, text);
    MODEL(import_log)(m, status, TEXT, TEXT + 32);
    return status;
}

void MODEL(init)(Model *m)
{
    m->trap = MODEL_TRAP_NONE;
    memset(m->memory, 0, MODEL_MEMORY_SIZE);
}

uint32_t MODEL(fmu_arguments)(Model *m, uint32_t size)
{
    (void)m;
    return size <= 256 ? ARGUMENTS : size <= 4096 ? ARGUMENTS + 256 : 0;
}

uint32_t MODEL(fmu_instantiate)(Model *m, uint32_t name, uint32_t token, uint32_t resources, uint32_t type,
                                uint32_t logging_on, uint32_t event_mode, uint32_t early_return, uint32_t variables,
                                uint32_t n, uint32_t has_update)
{
    (void)resources, (void)type, (void)logging_on, (void)event_mode, (void)early_return, (void)has_update;
    if (!name || !token || (n && !variables))
        return log_text(m, ERROR, "it cannot be instantiated"), 0;
    strcpy((char *)m->memory + MORE, model_string(m, name));
    return HANDLE;
}

void MODEL(fmu_free)(Model *m, uint32_t handle)
{
    (void)m, (void)handle;
}

uint32_t MODEL(fmu_count_elements)(Model *m, uint32_t handle, uint32_t references, uint32_t n)
{
    (void)m, (void)handle, (void)references;
    return n;
}

static uint32_t variable(Model *m, uint32_t references, uint32_t k)
{
    const uint32_t reference = model_load_u32(m, references + 4 * k);
    if (reference == OUT_OF_BOUNDS)
        m->trap = MODEL_TRAP_OUT_OF_BOUNDS;
    if (reference == PANIC) {
        log_text(m, FATAL, "src/lib.rs:1:1: the model panicked");
        m->trap = MODEL_TRAP_UNREACHABLE;
    }
    return reference < COUNT ? VARIABLES + 8 * reference : 0;
}

uint32_t MODEL(fmi3GetFloat64)(Model *m, uint32_t handle, uint32_t references, uint32_t n, uint32_t values,
                               uint32_t n_values)
{
    uint32_t k;
    if (handle != HANDLE || n != n_values || (n && (!references || !values)))
        return log_text(m, ERROR, "bad arguments");
    for (k = 0; k < n; ++k) {
        const uint32_t address = variable(m, references, k);
        model_store_f64(m, values + 8 * k, -1.0);
        if (m->trap)
            return 0;
        if (!address)
            return log_text(m, ERROR, "unknown");
        model_store_f64(m, values + 8 * k, model_load_f64(m, address));
    }
    return OK;
}

uint32_t MODEL(fmi3SetFloat64)(Model *m, uint32_t handle, uint32_t references, uint32_t n, uint32_t values,
                               uint32_t n_values)
{
    uint32_t k;
    if (handle != HANDLE || n != n_values || (n && (!references || !values)))
        return log_text(m, ERROR, "bad arguments");
    for (k = 0; k < n; ++k)
        if (!variable(m, references, k))
            return m->trap ? 0 : log_text(m, ERROR, "unknown");
    for (k = 0; k < n; ++k)
        model_store_f64(m, variable(m, references, k), model_load_f64(m, values + 8 * k));
    return OK;
}

uint32_t MODEL(fmi3SetBoolean)(Model *m, uint32_t handle, uint32_t references, uint32_t n, uint32_t values,
                               uint32_t n_values)
{
    (void)handle, (void)references, (void)n;
    return n_values == 3 && model_load_u8(m, values) == 1 && !model_load_u8(m, values + 1)
        && model_load_u8(m, values + 2) == 1 ? OK : ERROR;
}

uint32_t MODEL(fmi3GetString)(Model *m, uint32_t handle, uint32_t references, uint32_t n, uint32_t values,
                              uint32_t n_values)
{
    (void)handle, (void)references, (void)n;
    if (n_values != 1)
        return ERROR;
    model_store_u32(m, values, MORE);
    return OK;
}

uint32_t MODEL(fmi3SetString)(Model *m, uint32_t handle, uint32_t references, uint32_t n, uint32_t values,
                              uint32_t n_values)
{
    const uint32_t text = values ? model_load_u32(m, values) : 0;
    (void)handle, (void)references, (void)n;
    if (!text || n_values != 1)
        return log_text(m, ERROR, "bad arguments");
    strcpy((char *)m->memory + MORE, model_string(m, text));
    return OK;
}

uint32_t MODEL(fmi3SetBinary)(Model *m, uint32_t handle, uint32_t references, uint32_t n, uint32_t sizes,
                              uint32_t values, uint32_t n_values)
{
    (void)handle, (void)references, (void)n, (void)n_values;
    if (!sizes || !values || model_load_u32(m, sizes) != 3)
        return ERROR;
    memcpy(m->memory + MORE, m->memory + model_load_u32(m, values), 3);
    return OK;
}

uint32_t MODEL(fmi3GetBinary)(Model *m, uint32_t handle, uint32_t references, uint32_t n, uint32_t sizes,
                              uint32_t values, uint32_t n_values)
{
    (void)handle, (void)references, (void)n, (void)n_values;
    model_store_u32(m, sizes, 3);
    model_store_u32(m, values, MORE);
    return OK;
}

uint32_t MODEL(fmi3DoStep)(Model *m, uint32_t handle, double time, double step, uint32_t no_set_state, uint32_t event,
                           uint32_t terminate, uint32_t early, uint32_t last)
{
    const uint32_t end = VARIABLES + 8 * COUNT;
    (void)handle, (void)no_set_state, (void)event;
    model_store_u8(m, terminate, 0);
    model_store_f64(m, end, time + step);
    model_store_u8(m, early, (uint8_t)MODEL(import_intermediate_update)(m, time, 0, 1, 1, 1, end));
    if (m->trap)
        return 0;
    model_store_f64(m, last, model_load_f64(m, end));
    return step > 0 ? OK : ERROR;
}

/* A state is the first variable. */
uint32_t MODEL(fmi3GetFMUState)(Model *m, uint32_t handle, uint32_t state)
{
    (void)handle;
    if (!state || model_load_u32(m, state))
        return log_text(m, ERROR, "no state");
    model_store_f64(m, STATE, model_load_f64(m, VARIABLES));
    model_store_u32(m, state, STATE);
    return OK;
}

uint32_t MODEL(fmi3SetFMUState)(Model *m, uint32_t handle, uint32_t state)
{
    (void)handle;
    if (state != STATE)
        return log_text(m, ERROR, "no state");
    model_store_f64(m, VARIABLES, model_load_f64(m, STATE));
    return OK;
}

uint32_t MODEL(fmi3FreeFMUState)(Model *m, uint32_t handle, uint32_t state)
{
    (void)handle;
    if (state && model_load_u32(m, state) && model_load_u32(m, state) != STATE)
        return log_text(m, ERROR, "no state");
    if (state)
        model_store_u32(m, state, 0);
    return OK;
}

uint32_t MODEL(fmi3SerializedFMUStateSize)(Model *m, uint32_t handle, uint32_t state, uint32_t size)
{
    (void)handle;
    if (state != STATE)
        return log_text(m, ERROR, "no state");
    model_store_u32(m, size, 8);
    return OK;
}

uint32_t MODEL(fmi3SerializeFMUState)(Model *m, uint32_t handle, uint32_t state, uint32_t bytes, uint32_t size)
{
    (void)handle;
    if (state != STATE || size < 8)
        return log_text(m, ERROR, "no state");
    memcpy(m->memory + bytes, m->memory + STATE, 8);
    return OK;
}

uint32_t MODEL(fmi3DeserializeFMUState)(Model *m, uint32_t handle, uint32_t bytes, uint32_t size, uint32_t state)
{
    (void)handle;
    if (size != 8 || !state || model_load_u32(m, state))
        return log_text(m, ERROR, "no state");
    memcpy(m->memory + STATE, m->memory + bytes, 8);
    model_store_u32(m, state, STATE);
    return OK;
}
