/* Common parts of the hosts: loading a library on POSIX or Windows, or finding the functions of FMUs that
 * are linked into the program, and checks. Include fmi2.h or fmi3.h first. */
#ifndef HOST_H
#define HOST_H

#include <stdio.h>
#include <stdlib.h>

/* --- libraries -------------------------------------------------------------------------------- */

#if defined(LINKED)
#include <string.h>

/* The functions of FMUs in C that are linked into the program: rows of the name of an FMU, which is a prefix,
 * and the name of a function. */
#define LINK(library, name) void library##_##name(void);
#include LINKED
#undef LINK

static const struct {
    const char *library, *name;
    void (*function)(void);
} linked[] = {
#define LINK(library, name) {#library, #name, library##_##name},
#include LINKED
};

/* Its name takes the place of the path of a library. */
static void *load_library(const char *name)
{
    return (void *)name;
}

static void *look_up(void *library, const char *name)
{
    void *function;
    for (size_t i = 0; i < sizeof linked / sizeof *linked; ++i)
        if (!strcmp(linked[i].library, library) && !strcmp(linked[i].name, name)) {
            memcpy(&function, &linked[i].function, sizeof function);
            return function;
        }
    return NULL;
}

static void unload_library(void *library)
{
    (void)library;
}

#elif defined(_WIN32)
/* Declared here, since <windows.h> defines its own ERROR and GetVersion. */
__declspec(dllimport) void *LoadLibraryA(const char *path);
__declspec(dllimport) void *GetProcAddress(void *library, const char *name);
__declspec(dllimport) int FreeLibrary(void *library);
__declspec(dllimport) unsigned long GetLastError(void);

/* Loads a library, or prints the error and exits. */
static void *load_library(const char *path)
{
    void *library = LoadLibraryA(path);
    if (!library) {
        fprintf(stderr, "%s: error %lu\n", path, GetLastError());
        exit(2);
    }
    return library;
}

static void *look_up(void *library, const char *name)
{
    return GetProcAddress(library, name);
}

static void unload_library(void *library)
{
    FreeLibrary(library);
}

#else
#include <dlfcn.h>

static void *load_library(const char *path)
{
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!library) {
        fprintf(stderr, "%s\n", dlerror());
        exit(2);
    }
    return library;
}

static void *look_up(void *library, const char *name)
{
    return dlsym(library, name);
}

static void unload_library(void *library)
{
    dlclose(library);
}
#endif

/* Finds a function in a library, or reports that it is missing and exits. */
static void *find_function(void *library, const char *name)
{
    void *function = look_up(library, name);
    if (!function) {
        fprintf(stderr, "%s is missing\n", name);
        exit(2);
    }
    return function;
}

/* --- checks: a failure prints the line and sets the exit code to 1 ----------------------------- */

#define CHECK(condition) check((condition) != 0, #condition, __LINE__)
#define EXPECT(status, call) expect((status), (call), #call, __LINE__)

static void check(int holds, const char *what, int line)
{
    if (!holds) {
        fprintf(stderr, "line %d: not true: %s\n", line, what);
        exit(1);
    }
}

static void expect(Status expected, Status status, const char *call, int line)
{
    if (status != expected) {
        fprintf(stderr, "line %d: %d instead of %d: %s\n", line, status, expected, call);
        exit(1);
    }
}

#endif
