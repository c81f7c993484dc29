/* Repeats @CALLS@ calls of the FMU @FMU@ (FMI @FMI@, @INTERFACE@), recorded as the component @COMPONENT@.

     mkdir fmu && cd fmu && unzip ../@FMU@ && cd ..
     cc -o program THIS_FILE -ldl
     ./program fmu

   It prints each call before it is made, and what differs from the recorded results. The exit code is 0 if nothing
   differs, else 1. C99, for Linux, macOS and Windows; it needs nothing else. */
#define _XOPEN_SOURCE 700 /* for realpath */
#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#ifdef _WIN32
#include <windows.h>
#else
#include <dlfcn.h>
#endif

#define BINARY "@BINARY@"
/* Numbers may differ by ABSOLUTE + RELATIVE * the recorded value. */
#ifndef ABSOLUTE
#define ABSOLUTE 1e-12
#endif
#ifndef RELATIVE
#define RELATIVE 1e-6
#endif

static void *library, *instance, *states[@STATES@];
static char resources[4096];
static long call_number, differences;

static bool differs(double got, double expected) {
    double distance = got < expected ? expected - got : got - expected;
    double size = expected < 0 ? -expected : expected;
    if (got == expected || (got != got && expected != expected)) return false;
    return !(distance <= ABSOLUTE + RELATIVE * size);
}

/* Prints a call, at once in case it crashes. */
static void begin(long number, const char *text) {
    call_number = number;
    printf("call %ld, %s\n", number, text);
    fflush(stdout);
}

static void differ(const char *what, long index, double got, double expected) {
    printf("    DIFFERS: %s[%ld] = %.17g, recorded %.17g\n", what, index, got, expected);
    differences++;
}

/* Compares a status; without a recorded one, the recorded process has ended in the call. */
static void returned(int status, int expected, const char *ended) {
    if (ended != NULL) {
        printf("    DIFFERS: it returned %d; the recorded process %s\n", status, ended);
        differences++;
    } else if (status != expected) {
        printf("    DIFFERS: it returned %d, recorded %d\n", status, expected);
        differences++;
    }
}

#define CHECK(type, got, ...) \
    do { \
        static const type recorded[] = __VA_ARGS__; \
        for (size_t i = 0; i < sizeof recorded / sizeof *recorded; i++) \
            if (differs((double) got[i], (double) recorded[i])) \
                differ(#got, (long) i, (double) got[i], (double) recorded[i]); \
    } while (0)

#define CHECK_TEXT(type, got, ...) \
    do { \
        static const char *const recorded[] = __VA_ARGS__; \
        for (size_t i = 0; i < sizeof recorded / sizeof *recorded; i++) \
            if (got[i] == NULL || recorded[i] == NULL ? got[i] != recorded[i] \
                                                      : strcmp(got[i], recorded[i]) != 0) { \
                printf("    DIFFERS: %s[%ld] = \"%s\", recorded \"%s\"\n", #got, (long) i, \
                       got[i] ? got[i] : "NULL", recorded[i] ? recorded[i] : "NULL"); \
                differences++; \
            } \
    } while (0)

static void *function(const char *name) {
#ifdef _WIN32
    void *found = (void *) GetProcAddress((HMODULE) library, name);
#else
    void *found = dlsym(library, name);
#endif
    if (found == NULL) {
        printf("the binary has no function %s\n", name);
        exit(2);
    }
    return found;
}

