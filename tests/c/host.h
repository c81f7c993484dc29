/* Common parts of the hosts: loading a library on POSIX or Windows, and checks. Include fmi2.h or fmi3.h
 * first. */
#ifndef HOST_H
#define HOST_H

#include <stdio.h>
#include <stdlib.h>

/* --- shared libraries ------------------------------------------------------------------------- */

#ifdef _WIN32
/* Declared here, since <windows.h> defines its own ERROR and GetVersion. */
__declspec(dllimport) void *LoadLibraryA(const char *path);
__declspec(dllimport) void *GetProcAddress(void *library, const char *name);
__declspec(dllimport) int FreeLibrary(void *library);
__declspec(dllimport) unsigned long GetLastError(void);
#else
#include <dlfcn.h>
#endif

/* Loads a library, or prints the error and exits. */
static void *load_library(const char *path) {
#ifdef _WIN32
    void *library = LoadLibraryA(path);
    if (!library) fprintf(stderr, "%s: error %lu\n", path, GetLastError());
#else
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!library) fprintf(stderr, "%s\n", dlerror());
#endif
    if (!library) exit(2);
    return library;
}

/* Finds a function in a library, or reports that it is missing and exits. */
static void *find_function(void *library, const char *name) {
#ifdef _WIN32
    void *function = GetProcAddress(library, name);
#else
    void *function = dlsym(library, name);
#endif
    if (!function) {
        fprintf(stderr, "%s is missing\n", name);
        exit(2);
    }
    return function;
}

static void unload_library(void *library) {
#ifdef _WIN32
    FreeLibrary(library);
#else
    dlclose(library);
#endif
}

/* --- checks: a failure prints the line and sets the exit code to 1 ----------------------------- */

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
