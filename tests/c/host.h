/* What the hosts have in common: loading a library, and checks. */
#ifndef HOST_H
#define HOST_H

#include <stdio.h>
#include <stdlib.h>

#include "fmi2.h"

/* --- shared libraries ------------------------------------------------------------------------- */

#include <dlfcn.h>

/* Loads a library, or tells why not and exits. */
static void *load_library(const char *path) {
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!library) fprintf(stderr, "%s\n", dlerror());
    if (!library) exit(2);
    return library;
}

/* Finds a function of FMI 2.0 in a library, or tells that it is missing and exits. */
static void *find_function(void *library, const char *name) {
    void *function = dlsym(library, name);
    if (!function) {
        fprintf(stderr, "%s is missing\n", name);
        exit(2);
    }
    return function;
}

static void unload_library(void *library) {
    dlclose(library);
}

/* --- what is expected: else the line is told, and the exit code is 1 --------------------------- */

#define CHECK(condition) check((condition) != 0, #condition, __LINE__)
#define EXPECT(status, call) expect((status), (call), #call, __LINE__)

static void check(int holds, const char *what, int line) {
    if (!holds) {
        fprintf(stderr, "line %d: not true: %s\n", line, what);
        exit(1);
    }
}

static void expect(Status expected, Status status, const char *call, int line) {
    if (status != expected) {
        fprintf(stderr, "line %d: %d instead of %d: %s\n", line, status, expected, call);
        exit(1);
    }
}

#endif
