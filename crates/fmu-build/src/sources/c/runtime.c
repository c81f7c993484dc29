/* --- Instances ------------------------------------------------------------------------------------- */

typedef struct {
    Host host;
    uint32_t handle;      /* of the instance in the model */
    uint32_t arguments;   /* where the memory of the model has room for arguments: the room found first stays */
    const char *function; /* the name of the function that the host calls */
    int has_logged_fatal; /* whether the host knows why the instance ended */
    Model model;
} Instance;

/* The room for arguments that an instance has at hand (bytes). */
#define ARGUMENTS_SIZE @ARGUMENTS@u

/* A call of the host. */
typedef struct {
    Instance *instance;
    const char *function; /* the name of its function */
    fmiXStatus status;
    uint32_t next; /* where the memory of the model has room for the next argument */
} Call;

/* Logs why a function failed. */
static void log_failure(const Host *host, fmiXStatus status, const char *function, const char *why)
{
    char message[512] = "";
    strncat(message, function, sizeof message - 1);
    strncat(message, ": ", sizeof message - 1 - strlen(message));
    strncat(message, why, sizeof message - 1 - strlen(message));
    send_message(host, status, status == fmiXFatal ? "logStatusFatal" : "logStatusError", message);
}

/* Refuses a call. */
static void refuse(Call *call, const char *why)
{
    call->status = fmiXError;
    log_failure(&call->instance->host, fmiXError, call->function, why);
}

#ifdef FMU_STATIC_INSTANCES
static Instance instances[FMU_STATIC_INSTANCES];
static int is_in_use[FMU_STATIC_INSTANCES];

static Instance *block(const Host *host, const char *function)
{
    size_t k;
    for (k = 0; k < FMU_STATIC_INSTANCES; ++k)
        if (!is_in_use[k]) {
            is_in_use[k] = 1;
            return &instances[k];
        }
    log_failure(host, fmiXError, function,
                "all instances are in use; compile the FMU with a larger FMU_STATIC_INSTANCES");
    return NULL;
}

static void release_block(Instance *instance)
{
    is_in_use[instance - instances] = 0;
}
#else
static Instance *block(const Host *host, const char *function)
{
    Instance *const instance = allocate(host, sizeof(Instance));
    if (!instance)
        log_failure(host, fmiXError, function, "the host has no memory for the instance");
    return instance;
}

static void release_block(Instance *instance)
{
    const Host host = instance->host;
    release(&host, instance);
}
#endif

/* --- Calls of the model ----------------------------------------------------------------------------- */

/* Finds more room for the arguments of a call than an instance has at hand. */
static uint32_t more_room(Call *call, size_t size)
{
    Model *const model = &call->instance->model;
    const uint32_t room = size < MODEL_MEMORY_SIZE ? MODEL(fmu_arguments)(model, (uint32_t)size) : 0;
    if (!model_bytes(model, room, size))
        return 0;
    return room;
}

/* Begins a call with arguments of this size. Returns whether the model can be called. */
static inline int enter(Call *call, size_t size)
{
    Instance *const instance = call->instance;
    if (!instance || instance->model.trap != MODEL_TRAP_NONE) {
        call->status = instance ? fmiXFatal : fmiXError;
        return 0;
    }
    instance->function = call->function;
    call->next = size <= ARGUMENTS_SIZE ? instance->arguments : more_room(call, size);
    if (!call->next)
        refuse(call, "the arrays or strings are larger than the memory of the FMU");
    return call->next != 0;
}

/* Logs why an instance ended. */
static void end_instance(Call *call)
{
    Instance *const instance = call->instance;
    call->status = fmiXFatal;
    if (!instance->has_logged_fatal)
        log_failure(&instance->host, fmiXFatal, call->function, model_trap_message(instance->model.trap));
    instance->has_logged_fatal = 1;
}

/* Ends a call with the status that the model returned. Returns whether the instance is alive. */
static inline int leave(Call *call, uint32_t status)
{
    call->status = (fmiXStatus)status;
    if (call->instance->model.trap == MODEL_TRAP_NONE)
        return 1;
    end_instance(call);
    return 0;
}

/* The model sends a message. A fatal one is the message of a panic, which does not name the function. */
void MODEL(import_log)(Model *model, uint32_t status, uint32_t category, uint32_t message)
{
    Instance *const instance = model->host;
    const char *const name = model_string(model, category), *const text = model_string(model, message);
    if (!name || !text)
        return;
    if (status == fmiXFatal) {
        instance->has_logged_fatal = 1;
        log_failure(&instance->host, fmiXFatal, instance->function, text);
    } else {
        send_message(&instance->host, (fmiXStatus)status, name, text);
    }
}

/* --- Arguments --------------------------------------------------------------------------------------
 *
 * The model has a memory of its own, where a pointer is a 32-bit address. Arrays of the host are copied there before a
 * call, and back after it. NULL stays NULL, so that the model refuses it.
 */

/* The size of an array in the memory of the model: a multiple of 8, or more than the memory has. */
static inline size_t space(size_t n, size_t size)
{
    return n <= MODEL_MEMORY_SIZE / size ? (n * size + 7) & ~(size_t)7 : MODEL_MEMORY_SIZE;
}

/* Copies numbers from or to the memory of the model, where the least significant byte is the first one. */
static inline void copy(void *to, const void *from, size_t n, size_t size)
{
    const uint16_t one = 1;
    uint8_t first_byte;
    memcpy(&first_byte, &one, 1);
    if (first_byte == 1) {
        memcpy(to, from, n * size);
    } else {
        size_t k;
        for (k = 0; k < n * size; ++k)
            ((uint8_t *)to)[k] = ((const uint8_t *)from)[k - k % size + size - 1 - k % size];
    }
}

/* Passes room for an array of numbers. Returns its address. */
static inline uint32_t out_array(Call *call, const void *array, size_t n, size_t size)
{
    const uint32_t address = call->next;
    if (!array)
        return 0;
    call->next += (uint32_t)space(n, size);
    return address;
}

/* Passes an array of numbers. Returns its address. */
static inline uint32_t in_array(Call *call, const void *array, size_t n, size_t size)
{
    const uint32_t address = out_array(call, array, n, size);
    if (n == 1 && array) /* often, and then a constant size */
        copy(call->instance->model.memory + address, array, 1, size);
    else if (array)
        copy(call->instance->model.memory + address, array, n, size);
    return address;
}

/* Returns an array of numbers to the host. */
static inline void get_array(const Call *call, uint32_t address, void *array, size_t n, size_t size)
{
    if (n == 1 && array)
        copy(array, call->instance->model.memory + address, 1, size);
    else if (array)
        copy(array, call->instance->model.memory + address, n, size);
}

/* The size of strings with the array of their addresses. */
static size_t space_of_strings(const char *const strings[], size_t n)
{
    size_t sum = space(n, 4), k;
    for (k = 0; strings && sum < MODEL_MEMORY_SIZE && k < n; ++k)
        if (strings[k])
            sum += space(strlen(strings[k]) + 1, 1);
    return sum;
}

static uint32_t in_string(Call *call, const char *string)
{
    return in_array(call, string, string ? strlen(string) + 1 : 0, 1);
}

static uint32_t in_strings(Call *call, const char *const strings[], size_t n)
{
    const uint32_t address = out_array(call, strings, n, 4);
    size_t k;
    for (k = 0; strings && k < n; ++k)
        model_store_u32(&call->instance->model, address + 4 * (uint32_t)k, in_string(call, strings[k]));
    return address;
}

/* Returns strings, which are in the memory of the model until its next call. */
static void get_strings(const Call *call, uint32_t address, const char *strings[], size_t n)
{
    Model *const model = &call->instance->model;
    size_t k;
    for (k = 0; strings && k < n; ++k)
        strings[k] = model_string(model, model_load_u32(model, address + 4 * (uint32_t)k));
}

/* Returns sizes, which the model has in 32 bits. */
static void get_sizes(const Call *call, uint32_t address, size_t sizes[], size_t n)
{
    size_t k;
    for (k = 0; sizes && k < n; ++k)
        sizes[k] = model_load_u32(&call->instance->model, address + 4 * (uint32_t)k);
}

