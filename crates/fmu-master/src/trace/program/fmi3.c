typedef void (*fmi3LogMessageCallback)(void *, int, const char *, const char *);
typedef void (*fmi3Callback)(void);

static void log_message(void *environment, int status, const char *category, const char *text) {
    (void) environment;
    printf("    (%d, %s): %s\n", status, category ? category : "", text ? text : "");
    fflush(stdout);
}

static void locate(const char *folder) {
    snprintf(resources, sizeof resources, "%s/resources/", folder);
}

