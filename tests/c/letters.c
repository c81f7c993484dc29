/* A co-simulation FMU of FMI 3.0 that sends a text and bytes, which grow by one with each step, and keeps what it receives. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { OK, ERROR = 3 };
enum { TEXT = 1, BYTES, SAID, SENT, HEARD, RECEIVED };
enum { MOST = 64 };

typedef struct {
    size_t count, size;
    char text[MOST], said[MOST];
    uint8_t bytes[MOST], sent[MOST];
} Letters;

typedef const unsigned *References;

void *fmi3InstantiateCoSimulation(const char *name, const char *token) {
    return name && !strcmp(token, "{letters}") ? calloc(1, sizeof(Letters)) : NULL;
}

void fmi3FreeInstance(Letters *c) { free(c); }

int fmi3EnterInitializationMode(Letters *c) { return (void)c, OK; }

int fmi3ExitInitializationMode(Letters *c) { return (void)c, OK; }

int fmi3Terminate(Letters *c) { return (void)c, OK; }

int fmi3DoStep(Letters *c, double time, double step, bool final, bool *event, bool *terminate, bool *early,
               double *last) {
    (void)final;
    if (c->count + 1 == MOST) return ERROR;
    c->said[c->count] = (char)('a' + c->count % 26);
    c->sent[c->count] = (uint8_t)c->count;
    c->count++;
    *event = *terminate = *early = false;
    *last = time + step;
    return OK;
}

int fmi3SetString(Letters *c, References r, size_t n, const char *const *values, size_t count) {
    if (n != 1 || count != 1 || r[0] != TEXT || strlen(values[0]) >= MOST) return ERROR;
    strcpy(c->text, values[0]);
    return OK;
}

int fmi3GetString(Letters *c, References r, size_t n, const char **values, size_t count) {
    if (n != count) return ERROR;
    for (size_t k = 0; k < n; k++) values[k] = r[k] == SAID ? c->said : c->text;
    return OK;
}

int fmi3SetBinary(Letters *c, References r, size_t n, const size_t *sizes, const uint8_t *const *values, size_t count) {
    if (n != 1 || count != 1 || r[0] != BYTES || sizes[0] > MOST) return ERROR;
    c->size = sizes[0];
    memcpy(c->bytes, values[0], c->size);
    return OK;
}

int fmi3GetBinary(Letters *c, References r, size_t n, size_t *sizes, const uint8_t **values, size_t count) {
    if (n != count) return ERROR;
    for (size_t k = 0; k < n; k++) {
        sizes[k] = r[k] == SENT ? c->count : c->size;
        values[k] = r[k] == SENT ? c->sent : c->bytes;
    }
    return OK;
}
