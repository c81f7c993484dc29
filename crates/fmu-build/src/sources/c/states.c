/* --- Saved states -----------------------------------------------------------------------------------
 *
 * The host has a state as the bytes of its serialization, outside of the instance, so it may have as many as it likes. A
 * state in the memory of the model exists only during a call. Without a heap, and for models whose states cannot be
 * serialized, the states of the host are in the memory of the model, as many as fit, and each belongs to its instance.
 */

/* An address that is no state, for pointers of the host that point to none: the model refuses it. */
#define NOT_A_STATE 1u

#if defined(FMU_STATIC_INSTANCES) || !@IS_SERIALIZED@

/* Passes a state of this instance. */
static int in_state(Call *call, const void *state, uint32_t *address)
{
    *address = state ? NOT_A_STATE : 0;
    if (call->instance && state) {
        const uintptr_t offset = (uintptr_t)state - (uintptr_t)call->instance->model.memory;
        if (offset < MODEL_MEMORY_SIZE)
            *address = (uint32_t)offset;
    }
    return 1;
}

/* Ends the use of a state that was passed. */
static void end_state(Call *call, uint32_t address)
{
    (void)call, (void)address;
}

/* What a serialized state needs. */
static size_t size_of_state(Call *call, const void *state, uint32_t address)
{
    (void)state;
    if (address <= NOT_A_STATE || !enter(call, space(1, 4)))
        return 0;
    leave(call, MODEL(@SIZE_OF_STATE@)(&call->instance->model, call->instance->handle, address, call->next));
    return call->status == fmiXOK ? model_load_u32(&call->instance->model, call->next) : 0;
}

/* The state that the model shall change in a variable of the host. */
static uint32_t state_to_change(Call *call, const void *state)
{
    uint32_t address;
    in_state(call, state, &address);
    return address;
}

/* Sets a variable of the host to a state. */
static void set_state(Call *call, uint32_t address, void **state)
{
    *state = address ? model_bytes(&call->instance->model, address, 0) : NULL;
}

#else

typedef struct {
    char magic[8]; /* distinguishes states from other memory */
    size_t size;
    uint8_t bytes[];
} State;

static const char state_magic[8] = {'F', 'M', 'U', 'S', 'O', 'U', 'R', 'C'};

static int is_state(const void *state)
{
    return !memcmp(state, state_magic, sizeof state_magic);
}

/* What a serialized state needs. */
static size_t size_of_state(Call *call, const void *state, uint32_t address)
{
    (void)call, (void)address;
    return state && is_state(state) ? ((const State *)state)->size : 0;
}

/* Ends the use of a state that was passed. */
static void end_state(Call *call, uint32_t address)
{
    Call end = {call->instance, call->function, fmiXError, 0};
    if (address > NOT_A_STATE && enter(&end, space(1, 4))) {
        model_store_u32(&end.instance->model, end.next, address);
        if (!leave(&end, MODEL(@FREE_STATE@)(&end.instance->model, end.instance->handle, end.next)))
            call->status = end.status;
    }
}

/* Passes a state. Returns whether this succeeded. */
static int in_state(Call *call, const void *state, uint32_t *address)
{
    const State *const saved = state;
    Call load = {call->instance, call->function, fmiXError, 0};
    *address = state ? NOT_A_STATE : 0;
    if (!call->instance || !state || !is_state(state))
        return 1;
    if (enter(&load, space(saved->size, 1) + space(1, 4))) {
        Model *const model = &load.instance->model;
        const uint32_t bytes = in_array(&load, saved->bytes, saved->size, 1), variable = load.next;
        model_store_u32(model, variable, 0);
        leave(&load, MODEL(@DESERIALIZE_STATE@)(model, load.instance->handle, bytes, (uint32_t)saved->size, variable));
        *address = model_load_u32(model, variable);
    }
    call->status = load.status;
    return load.status == fmiXOK;
}

/* The state that the model shall change in a variable of the host: it makes a new one, in place of one of the host's. */
static uint32_t state_to_change(const Call *call, const void *state)
{
    (void)call;
    return !state || is_state(state) ? 0 : NOT_A_STATE;
}

/* Serializes a state of the model to memory of the host. */
static State *saved(Call *call, uint32_t address)
{
    Instance *const instance = call->instance;
    Model *const model = &instance->model;
    State *state = NULL;
    uint32_t size;
    if (!enter(call, space(1, 4))
        || !leave(call, MODEL(@SIZE_OF_STATE@)(model, instance->handle, address, call->next))
        || call->status != fmiXOK)
        return NULL;
    size = model_load_u32(model, call->next);
    if (!enter(call, space(size, 1)))
        return NULL;
    if (leave(call, MODEL(@SERIALIZE_STATE@)(model, instance->handle, address, call->next, size))
        && call->status == fmiXOK) {
        state = allocate(&instance->host, sizeof *state + size);
        if (state) {
            memcpy(state->magic, state_magic, sizeof state_magic);
            state->size = size;
            get_array(call, call->next, state->bytes, size, 1);
        } else {
            refuse(call, "the host has no memory for the state");
        }
    }
    return state;
}

/* Sets a variable of the host to a state. */
static void set_state(Call *call, uint32_t address, void **variable)
{
    State *new_state = NULL;
    if (address) {
        new_state = saved(call, address);
        end_state(call, address);
        if (!new_state)
            return;
    }
    if (*variable) {
        memset(*variable, 0, sizeof state_magic);
        release(&call->instance->host, *variable);
    }
    *variable = new_state;
}

#endif

/* Passes a variable of the host for a state. Returns its address. */
static uint32_t in_state_variable(Call *call, void **state)
{
    const uint32_t address = out_array(call, state, 1, 4);
    if (state)
        model_store_u32(&call->instance->model, address, state_to_change(call, *state));
    return address;
}

/* Returns a state in a variable of the host. */
static void get_state_variable(Call *call, uint32_t address, void **state)
{
    if (state)
        set_state(call, model_load_u32(&call->instance->model, address), state);
}

