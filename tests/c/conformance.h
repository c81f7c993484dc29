/* The defects that `conformance.c` can be compiled with, and the side effects that some of them have.
 *
 * `-DDEFECT=NAME` plants one defect. Without it the FMU has none.
 */
#ifndef CONFORMANCE_H
#define CONFORMANCE_H

#include <errno.h>
#include <fcntl.h>
#include <fenv.h>
#include <float.h>
#include <limits.h>
#include <locale.h>
#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>
#include <xmmintrin.h>

#define PLANT(name, kind, rule, description) name,
enum Defect {
    NO_DEFECT,
#include "defects.h"
};
#undef PLANT

#ifndef DEFECT
#define DEFECT NO_DEFECT
#endif

/* Whether the FMU is compiled with a defect. */
#define HAS(defect) (DEFECT == defect)

static inline void crash(void) { *(volatile int *)8 = 0; }

static inline void hang(void) {
    for (volatile int forever = 1; forever;) {}
}

/* Allocates memory, uses it and forgets it. */
static inline void leak(size_t size) {
    char *volatile block = malloc(size);
    if (block) memset(block, 1, size);
}

static inline int recurse(volatile char *outer) {
    volatile char frame[4096];
    frame[0] = outer ? *outer : 1;
    return frame[0] ? recurse(frame) + frame[0] : 0;
}

static inline void ignore_signal(int number) { (void)number; }

static inline void *wait_forever(void *argument) {
    for (;;) pause();
    return argument;
}

static inline void write_file(const char *path) {
    FILE *file = fopen(path, "w");
    if (!file) return;
    fputs("written by the FMU\n", file);
    fclose(file);
}

/* What a defect does to the process when an instance is made. */
static inline void change_process(const char *resources) {
    switch (DEFECT) {
    case EXIT_IN_INSTANTIATE: exit(0);
    case CLOSES_STDOUT: close(STDOUT_FILENO); break;
    case CHANGES_DIRECTORY: if (chdir("/")) abort(); break;
    case CHANGES_LOCALE: setlocale(LC_ALL, "C.UTF-8"); break;
    case CHANGES_ROUNDING_MODE: fesetround(FE_UPWARD); break;
    case SETS_FLUSH_TO_ZERO: _MM_SET_FLUSH_ZERO_MODE(_MM_FLUSH_ZERO_ON); break;
    case ENABLES_FP_EXCEPTIONS: feenableexcept(FE_DIVBYZERO | FE_INVALID | FE_OVERFLOW); break;
    case CHANGES_UMASK: umask(0); break;
    case CHANGES_RANDOM_SEED: srand(1); srandom(1); break;
    case INSTALLS_SIGNAL_HANDLER:
        signal(SIGSEGV, ignore_signal);
        signal(SIGINT, ignore_signal);
        break;
    case IGNORES_INTERRUPTS: signal(SIGINT, SIG_IGN); break;
    case LEAVES_THREAD: {
        pthread_t thread;
        pthread_create(&thread, NULL, wait_forever, NULL);
        break;
    }
    case LEAVES_CHILD:
        if (!fork()) {
            execlp("sleep", "sleep", "30", (char *)NULL);
            _exit(1);
        }
        break;
    case SETS_ALARM: alarm(1); break;
    case LEAVES_FILE_OPEN: if (open("/dev/null", O_RDONLY) < 0) abort(); break;
    case WRITES_FILE_IN_CWD: write_file("conformance.log"); break;
    case WRITES_FILE_ABOVE: write_file("../conformance.log"); break;
    case WRITES_RESOURCES: {
        char path[PATH_MAX];
        if (!resources || strncmp(resources, "file://", 7)) break;
        snprintf(path, sizeof path, "%s/conformance.log", resources + 7);
        write_file(path);
        break;
    }
    case SETS_ENVIRONMENT: setenv("CONFORMANCE", "1", 1); break;
    default: break;
    }
}

/* What a defect does in a step that ends at `time` [s]. */
static inline void disturb_step(double time) {
    static double slow[1000];
    switch (DEFECT) {
    case CRASH_IN_STEP: crash(); break;
    case CRASH_LATER: if (time > 0.5) crash(); break;
    case ABORT_LATER: if (time > 0.5) abort(); break;
    case EXIT_LATER: if (time > 0.5) exit(0); break;
    case STACK_OVERFLOW_LATER: if (time > 0.5) recurse(NULL); break;
    case HANG_IN_STEP: if (time > 0.5) hang(); break;
    case PRINTS_TO_STDOUT: printf("t = %g\n", time); fflush(stdout); break;
    case PRINTS_TO_STDERR: fprintf(stderr, "t = %g\n", time); break;
    case LEAK_PER_STEP: leak(1000); break;
    case FILLS_MEMORY: if (time > 0.5) for (;;) leak(1 << 20); break;
    case OVERFLOWS_HEAP: {
        volatile char *block = malloc(40);
        for (int i = 0; block && i < 64; i++) block[i] = 0x55;
        free((void *)block);
        break;
    }
    case DOUBLE_FREE: {
        void *volatile block = malloc(2000);
        free(block);
        free(block);
        break;
    }
    case STEPS_SLOW_DOWN: {
        static long steps;
        steps += 10;
        for (long i = 0; i < steps * steps; i++) slow[i % 1000] += 1;
        break;
    }
    default: break;
    }
}

#endif
