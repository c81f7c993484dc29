/* A co-simulation FMU of FMI 3.0 with arrays and rare types, whose outputs follow from its inputs at once.
   It has only the functions that the master calls. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    uint8_t u[3];
    float x;
    bool b;
    size_t length;
} Sums;

typedef const unsigned int *References;

void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                  bool logging, bool events, bool early, References intermediate, size_t n,
                                  void *environment, void *log, void *update) {
    (void)name, (void)resources, (void)visible, (void)logging, (void)intermediate, (void)n;
    (void)environment, (void)log, (void)update;
    if (strcmp(token, "{sums}") || events || early) return NULL;
    Sums *sums = calloc(1, sizeof *sums);
    memcpy(sums->u, (uint8_t[]){1, 2, 3}, 3);
    return sums;
}

void fmi3FreeInstance(void *instance) { free(instance); }

int fmi3EnterInitializationMode(void *instance, bool has_tolerance, double tolerance, double start,
                                bool has_stop, double stop) {
    (void)instance, (void)has_tolerance, (void)tolerance;
    return start == 0 && has_stop && stop == 1 ? 0 : 3;
}

int fmi3ExitInitializationMode(void *instance) { return (void)instance, 0; }

int fmi3Terminate(void *instance) { return (void)instance, 0; }

int fmi3DoStep(void *instance, double time, double step, bool final, bool *event, bool *terminate,
               bool *early, double *last) {
    (void)final;
    *event = *early = false;
    *terminate = ((Sums *)instance)->u[0] == 99;
    *last = time + step;
    return 0;
}

int fmi3SetUInt8(void *instance, References r, size_t n, const uint8_t *values, size_t count) {
    if (n != 1 || r[0] != 1 || count != 3) return 3;
    memcpy(((Sums *)instance)->u, values, 3);
    return 0;
}

int fmi3SetFloat32(void *instance, References r, size_t n, const float *values, size_t count) {
    if (n != 1 || r[0] != 3 || count != 1) return 3;
    ((Sums *)instance)->x = values[0];
    return 0;
}

int fmi3SetBoolean(void *instance, References r, size_t n, const bool *values, size_t count) {
    if (n != 1 || r[0] != 5 || count != 1) return 3;
    ((Sums *)instance)->b = values[0];
    return 0;
}

int fmi3SetString(void *instance, References r, size_t n, const char *const *values, size_t count) {
    if (n != 1 || r[0] != 7 || count != 2) return 3;
    ((Sums *)instance)->length = strlen(values[0]) + 10 * strlen(values[1]);
    return 0;
}

int fmi3GetInt64(void *instance, References r, size_t n, int64_t *values, size_t count) {
    const Sums *sums = instance;
    if (n != count) return 3;
    for (size_t i = 0; i < n; i++) {
        switch (r[i]) {
        case 2: values[i] = sums->u[0] + 10 * sums->u[1] + 100 * sums->u[2]; break;
        case 11: values[i] = 9007199254740993; break;
        case 13: values[i] = sums->b ? 2 : -5000000000; break;
        default: return 3;
        }
    }
    return 0;
}

int fmi3GetUInt64(void *instance, References r, size_t n, uint64_t *values, size_t count) {
    if (!instance || n != 1 || r[0] != 12 || count != 1) return 3;
    values[0] = UINT64_MAX;
    return 0;
}

int fmi3GetString(void *instance, References r, size_t n, const char **values, size_t count) {
    if (!instance || n != 1 || r[0] != 14 || count != 3) return 3;
    values[0] = "";
    values[1] = "a \"b\", c";
    values[2] = "\xcf\x80\nline 2";
    return 0;
}

int fmi3GetBinary(void *instance, References r, size_t n, size_t *sizes, const uint8_t **values, size_t count) {
    static const uint8_t bytes[] = {0x00, 0x1f, 0xff};
    if (n != 1 || r[0] != 9 || count != 1) return 3;
    sizes[0] = ((Sums *)instance)->b ? 0 : 3;
    values[0] = bytes;
    return 0;
}

int fmi3GetFloat32(void *instance, References r, size_t n, float *values, size_t count) {
    if (n != 1 || r[0] != 4 || count != 1) return 3;
    values[0] = ((Sums *)instance)->x + 0.1f;
    return 0;
}

int fmi3GetBoolean(void *instance, References r, size_t n, bool *values, size_t count) {
    if (n != 1 || r[0] != 6 || count != 1) return 3;
    values[0] = !((Sums *)instance)->b;
    return 0;
}

int fmi3GetInt16(void *instance, References r, size_t n, int16_t *values, size_t count) {
    if (n != 1 || r[0] != 8 || count != 4) return 3;
    for (int i = 0; i < 4; i++) values[i] = (int16_t)(-i - (int)((Sums *)instance)->length);
    return 0;
}
