/* The functions of FMI @VERSION@ for the model @MODEL@. They pass the arguments of the host to the model in model.c, which
 * has a memory of its own, and copy its results back.
 *
 * Compile this file and the others in this folder with any C99 compiler, without -ffast-math. These macros may be
 * defined, for example with -D:
 *
 *   FMIX_FUNCTION_PREFIX   a prefix for the functions, such as @PREFIX@, for a program with several FMUs
 *   FMU_STATIC_INSTANCES   the number of instances, to have them in static memory instead of the heap
 *
 * An instance is one block of memory, sizeof(Instance) bytes. Only states that the host asks for are outside of it. There
 * are no other variables, so instances are independent of each other. A panic or another failure of the model ends its
 * instance, which can then only be freed.
 */
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#ifndef FMU_STATIC_INSTANCES
#include <stdlib.h>
#endif

#include "model.h"

/* --- Names ------------------------------------------------------------------------------------------
 *
 * Without a macro, functions have their names in shared libraries, which FMPy and fmusim compile without any. If the
 * compiler finds the header of the standard, which importers have, this header decides.
 */
#ifdef __has_include
#if __has_include("fmiXFunctions.h")
#include "fmiXFunctions.h"
#endif
#endif

#ifndef fmiXFunctions_h

#if defined(FMIX_FUNCTION_PREFIX) && !defined(FMIX_OVERRIDE_FUNCTION_PREFIX)
#define FMIX_ACTUAL_FUNCTION_PREFIX FMIX_FUNCTION_PREFIX
#endif

#ifdef FMIX_ACTUAL_FUNCTION_PREFIX
#define fmiXPaste(prefix, name) prefix##name
#define fmiXPasteB(prefix, name) fmiXPaste(prefix, name)
#define fmiXFullName(name) fmiXPasteB(FMIX_ACTUAL_FUNCTION_PREFIX, name)
#else
#define fmiXFullName(name) name
#endif

#ifndef FMIX_Export
#if defined(FMIX_ACTUAL_FUNCTION_PREFIX)
#define FMIX_Export
#elif defined(_WIN32) || defined(__CYGWIN__)
#define FMIX_Export __declspec(dllexport)
#elif defined(__GNUC__) && __GNUC__ >= 4
#define FMIX_Export __attribute__((visibility("default")))
#else
#define FMIX_Export
#endif
#endif

