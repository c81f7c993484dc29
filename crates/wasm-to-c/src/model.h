/* @DESCRIPTION@: the model, as model.c defines it. */

#ifndef MODEL_H
#define MODEL_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

/* The name of a symbol that the linker sees. */
#ifndef MODEL
#define MODEL(name) @PREFIX@##name
#endif

/* The size in bytes of the linear memory of an instance, which may be raised, but not lowered. */
#ifndef MODEL_MEMORY_SIZE
#define MODEL_MEMORY_SIZE @MEMORY_SIZE@
#elif MODEL_MEMORY_SIZE < @MEMORY_SIZE@
#error "MODEL_MEMORY_SIZE is less than the model needs, @MEMORY_SIZE@ bytes"
#endif

/* How deep functions may call each other in a circle. */
#ifndef MODEL_CALL_DEPTH
#define MODEL_CALL_DEPTH 256
#endif

/* Why an instance ended: the values of Model.trap. An instance with a trap cannot be called any more, only freed or
   initialized again. */
enum {
    MODEL_TRAP_NONE,
    MODEL_TRAP_UNREACHABLE,   /* a panic, after its message was logged */
    MODEL_TRAP_OUT_OF_BOUNDS, /* an access beyond the memory; a stack that is too small ends so, too */
    MODEL_TRAP_DIVISION,      /* an integer division by zero, or one that overflows */
    MODEL_TRAP_CONVERSION,    /* a number that does not fit in an integer */
    MODEL_TRAP_CALL,          /* a call by a pointer that points to no function of the type */
    MODEL_TRAP_DEPTH          /* more than MODEL_CALL_DEPTH calls in a circle */
};

/* An instance: its whole state is in this struct, which may be anywhere, and has no pointers into itself. */
typedef struct Model {
    void *host;   /* for the functions that the model calls; the model does not touch it, nor does MODEL(init) */
    int32_t trap; /* MODEL_TRAP_NONE while the instance lives */
    uint32_t depth;
    uint32_t pages;
@GLOBALS@    uint8_t memory[MODEL_MEMORY_SIZE];
} Model;

/* A shared library keeps these functions to itself, so that another one with the same names cannot replace them. */
#if defined(__GNUC__) && !defined(_WIN32) && !defined(__CYGWIN__)
#pragma GCC visibility push(hidden)
#endif

/* Initialize an instance: all of it but `host`. */
void MODEL(init)(Model *m);

/* The functions of the model. Each returns zero when the instance has a trap. */
@EXPORTS@
/* The functions that the model calls, to be defined elsewhere. */
@IMPORTS@
#if defined(__GNUC__) && !defined(_WIN32) && !defined(__CYGWIN__)
#pragma GCC visibility pop
#endif

/* What a trap means, in words. */
static inline const char *model_trap_message(int32_t trap) {
    switch (trap) {
    case MODEL_TRAP_NONE: return "no trap";
    case MODEL_TRAP_UNREACHABLE: return "the model panicked";
    case MODEL_TRAP_OUT_OF_BOUNDS: return "access out of bounds of the memory, or the stack is too small";
    case MODEL_TRAP_DIVISION: return "integer division by zero or with overflow";
    case MODEL_TRAP_CONVERSION: return "a number is out of range for conversion to an integer";
    case MODEL_TRAP_CALL: return "call of a function pointer of the wrong type";
    default: return "too many nested calls";
    }
}

/* Access to the memory of an instance, which is little-endian on every processor. An address is where wasm has a pointer. */

/* The bytes from `address` on, or NULL if fewer than `size` are there. */
static inline uint8_t *model_bytes(Model *m, uint32_t address, size_t size) {
    return size <= MODEL_MEMORY_SIZE && address <= MODEL_MEMORY_SIZE - size ? m->memory + address : NULL;
}

/* The string at `address`, or NULL if it does not end within the memory. */
static inline const char *model_string(Model *m, uint32_t address) {
    return address < MODEL_MEMORY_SIZE && memchr(m->memory + address, 0, MODEL_MEMORY_SIZE - address)
        ? (const char *)m->memory + address : NULL;
}

/* Each function for loading returns zero, and each function for storing does nothing, where an address is out of
   bounds; both set the trap then. */
static inline uint64_t model_load(Model *m, uint32_t address, uint32_t size) {
    uint64_t value = 0;
    if (address > MODEL_MEMORY_SIZE - size) {
        m->trap = MODEL_TRAP_OUT_OF_BOUNDS;
        return 0;
    }
    while (size-- > 0)
        value = value << 8 | m->memory[address + size];
    return value;
}

static inline void model_store(Model *m, uint32_t address, uint32_t size, uint64_t value) {
    uint32_t i;
    if (address > MODEL_MEMORY_SIZE - size) {
        m->trap = MODEL_TRAP_OUT_OF_BOUNDS;
        return;
    }
    for (i = 0; i < size; i++)
        m->memory[address + i] = (uint8_t)(value >> 8 * i);
}

static inline uint8_t model_load_u8(Model *m, uint32_t address) {
    return (uint8_t)model_load(m, address, 1);
}

static inline uint16_t model_load_u16(Model *m, uint32_t address) {
    return (uint16_t)model_load(m, address, 2);
}

static inline uint32_t model_load_u32(Model *m, uint32_t address) {
    return (uint32_t)model_load(m, address, 4);
}

static inline uint64_t model_load_u64(Model *m, uint32_t address) {
    return model_load(m, address, 8);
}

static inline float model_load_f32(Model *m, uint32_t address) {
    uint32_t bits = model_load_u32(m, address);
    float value;
    memcpy(&value, &bits, 4);
    return value;
}

static inline double model_load_f64(Model *m, uint32_t address) {
    uint64_t bits = model_load_u64(m, address);
    double value;
    memcpy(&value, &bits, 8);
    return value;
}

static inline void model_store_u8(Model *m, uint32_t address, uint8_t value) {
    model_store(m, address, 1, value);
}

static inline void model_store_u16(Model *m, uint32_t address, uint16_t value) {
    model_store(m, address, 2, value);
}

static inline void model_store_u32(Model *m, uint32_t address, uint32_t value) {
    model_store(m, address, 4, value);
}

static inline void model_store_u64(Model *m, uint32_t address, uint64_t value) {
    model_store(m, address, 8, value);
}

static inline void model_store_f32(Model *m, uint32_t address, float value) {
    uint32_t bits;
    memcpy(&bits, &value, 4);
    model_store_u32(m, address, bits);
}

static inline void model_store_f64(Model *m, uint32_t address, double value) {
    uint64_t bits;
    memcpy(&bits, &value, 8);
    model_store_u64(m, address, bits);
}

#endif
