/* Written by fmu-cc: where the global variables of LIBRARY are, and the library that contains them. */
#include <stdint.h>

struct extent {
    char *start, *end;
    const char *image_start, *image_end;
    uint64_t code;
};

extern char __start_SECTION[], __stop_SECTION[];
extern const char __ehdr_start[] __attribute__((visibility("hidden")));
extern const char _end[] __attribute__((visibility("hidden")));

/* The section exists, even if there are no variables. */
static volatile char first __attribute__((aligned(64)));

void fmu_c_LIBRARY(struct extent *extent)
{
    (void)first;
    extent->start = __start_SECTION;
    extent->end = __stop_SECTION;
    extent->image_start = __ehdr_start;
    extent->image_end = _end;
    extent->code = HASHull;
}
