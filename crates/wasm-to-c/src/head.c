/* @DESCRIPTION@: the model, translated from WebAssembly to C.

   The model was written in Rust. The Rust compiler optimized it and compiled it to a WebAssembly module, and each
   function of the module is a function here: its comment is its path in Rust, where it is the first of that path.
   Names of variables, types and lines are lost on the way, and many functions of Rust were inlined in others. The
   state of an instance is in `memory`, at the addresses that the compiler chose: `F64(a0, 16)` is a field 16 bytes
   from the beginning of the struct at the address a0, and `SET_F64(a0, 16, x)` changes it. a0, a1, ... are
   parameters; n, w, s and x are local variables (u32, u64, f32 and f64); t, r and p are values in between.

   All addresses are checked. A trap (see model.h) ends the instance: all functions return up to the caller.
   Floating-point numbers are computed as IEEE 754 says it, operation by operation, so that the results are the same
   bits on every processor. */

#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if defined __FAST_MATH__ || defined __ASSOCIATIVE_MATH__ || defined __RECIPROCAL_MATH__ || defined __NO_SIGNED_ZEROS__ \
    || (defined __FINITE_MATH_ONLY__ && __FINITE_MATH_ONLY__ > 0) || defined _M_FP_FAST
#error "Compile the model without -ffast-math (/fp:fast) and the options that it implies: they change the bits of results"
#endif
#if (defined FLT_EVAL_METHOD && FLT_EVAL_METHOD != 0 && FLT_EVAL_METHOD != 1) || (defined __TINYC__ && defined __i386__)
#error "Compile the model for the SSE2 unit (gcc: -msse2 -mfpmath=sse): the x87 unit has other bits"
#endif
/* No fused multiplication and addition, which rounds once instead of twice. */
#if defined __GNUC__ && !defined __clang__
#pragma GCC optimize("fp-contract=off")
#elif defined _MSC_VER && !defined __clang__
#pragma fp_contract(off)
#else
#pragma STDC FP_CONTRACT OFF
#endif

#include "model.h"

#if (defined __BYTE_ORDER__ && defined __ORDER_LITTLE_ENDIAN__ && __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__) \
    || defined __x86_64__ || defined __i386__ || defined _M_X64 || defined _M_IX86 || defined _M_ARM64
#define LITTLE_ENDIAN_MEMORY
#endif

/* Ends the instance, which keeps its first reason. */
#define TRAP(reason) \
    if (m->trap == MODEL_TRAP_NONE) m->trap = MODEL_TRAP_##reason

/* A call in a function that returns nothing, or a value. If the call had a trap, the function returns, too. */
#define TRY(call) \
    call; \
    if (m->trap != MODEL_TRAP_NONE) return
#define TRY0(call) \
    call; \
    if (m->trap != MODEL_TRAP_NONE) return 0

/* Leaves the function unless `end` bytes from the address on are in memory. */
#define CHECK(address, end) \
    if ((address) > MODEL_MEMORY_SIZE - (end)) goto out_of_bounds

/* Takes the stack frame of a function, `size` bytes of the memory whose address goes to a new variable. */
#define FRAME(address, size) \
    u32 address = m->g0 - (size); \
    CHECK(address, size); \
    m->g0 = address

/* Begins a function that is called in a circle. */
#define COUNT_DEPTH \
    if (m->depth >= MODEL_CALL_DEPTH) goto too_deep; \
    m->depth++

/* A call of a function that always ends with a trap: a panic. */
#define NEVER_RETURNS(call) \
    call; \
    goto unreachable

/* The ends of functions that have a trap. */
#define OUT_OF_BOUNDS out_of_bounds: TRAP(OUT_OF_BOUNDS); return
#define UNREACHABLE unreachable: TRAP(UNREACHABLE); return
#define BAD_DIVISION bad_division: TRAP(DIVISION); return
#define BAD_CONVERSION bad_conversion: TRAP(CONVERSION); return
#define TOO_DEEP too_deep: TRAP(DEPTH); return
