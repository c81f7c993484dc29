/* A co-simulation FMU of FMI 3.0 that returns what it was given: whole numbers of 64 bits, matrices, an item and bytes. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { OK, ERROR = 3 };
enum { W = 1, WS, I, A, M, E, B, OUT = 10 };

typedef struct {
    uint64_t w, ws[2];
    int64_t i;
    double a[6], m[6];
    int64_t e;
    size_t size;
    uint8_t bytes[16];
} Echo;

typedef const unsigned *References;

void *fmi3InstantiateCoSimulation(const char *name, const char *token) {
    return name && !strcmp(token, "{echo}") ? calloc(1, sizeof(Echo)) : NULL;
}

void fmi3FreeInstance(Echo *c) { free(c); }

int fmi3EnterInitializationMode(Echo *c) { return (void)c, OK; }

int fmi3ExitInitializationMode(Echo *c) { return (void)c, OK; }

int fmi3Terminate(Echo *c) { return (void)c, OK; }

int fmi3DoStep(Echo *c, double time, double step, bool final, bool *event, bool *terminate, bool *early,
               double *last) {
    (void)c, (void)final;
    *event = *terminate = *early = false;
    *last = time + step;
    return OK;
}

/* Where the values of a variable are, and their size. */
static void *place(Echo *c, unsigned r, size_t *size) {
    switch (r % OUT) {
    case W: return *size = sizeof c->w, &c->w;
    case WS: return *size = sizeof c->ws, c->ws;
    case I: return *size = sizeof c->i, &c->i;
    case A: return *size = sizeof c->a, c->a;
    case M: return *size = sizeof c->m, c->m;
    case E: return *size = sizeof c->e, &c->e;
    }
    return NULL;
}

/* All types but Binary have 8 bytes. */
static int access(Echo *c, References r, size_t n, void *values, size_t count, bool sets) {
    char *at = values, *end = at + 8 * count;
    for (size_t k = 0, size; k < n; k++, at += size) {
        void *own = place(c, r[k], &size);
        if (!own || (size_t)(end - at) < size) return ERROR;
        sets ? memcpy(own, at, size) : memcpy(at, own, size);
    }
    return at == end ? OK : ERROR;
}

int fmi3SetUInt64(Echo *c, References r, size_t n, const uint64_t *values, size_t count) {
#ifdef ON_SET
    ON_SET;
#endif
    return access(c, r, n, (void *)values, count, true);
}

int fmi3SetInt64(Echo *c, References r, size_t n, const int64_t *values, size_t count) {
    return access(c, r, n, (void *)values, count, true);
}

int fmi3SetFloat64(Echo *c, References r, size_t n, const double *values, size_t count) {
    return access(c, r, n, (void *)values, count, true);
}

int fmi3GetUInt64(Echo *c, References r, size_t n, uint64_t *values, size_t count) {
#ifdef ON_GET
    ON_GET;
#endif
    return access(c, r, n, values, count, false);
}

int fmi3GetInt64(Echo *c, References r, size_t n, int64_t *values, size_t count) {
    return access(c, r, n, values, count, false);
}

int fmi3GetFloat64(Echo *c, References r, size_t n, double *values, size_t count) {
    return access(c, r, n, values, count, false);
}

int fmi3SetBinary(Echo *c, References r, size_t n, const size_t *sizes, const uint8_t *const *values, size_t count) {
    if (n != 1 || count != 1 || r[0] % OUT != B || sizes[0] > sizeof c->bytes) return ERROR;
    c->size = sizes[0];
    memcpy(c->bytes, values[0], c->size);
    return OK;
}

int fmi3GetBinary(Echo *c, References r, size_t n, size_t *sizes, const uint8_t **values, size_t count) {
    if (n != 1 || count != 1 || r[0] % OUT != B) return ERROR;
    sizes[0] = c->size;
    values[0] = c->bytes;
    return OK;
}
