
int main(int count, char **arguments) {
    char folder[2048], binary[4096];
    if (count != 2) {
        printf("usage: %s FOLDER, in which the FMU is unpacked\n", arguments[0]);
        return 2;
    }
#ifdef _WIN32
    if (_fullpath(folder, arguments[1], sizeof folder) == NULL) return 2;
    for (char *c = folder; *c; c++) if (*c == '\\') *c = '/';
    snprintf(binary, sizeof binary, "%s/%s", folder, BINARY);
    library = (void *) LoadLibraryA(binary);
    if (library == NULL) {
        printf("%s cannot be loaded: error %lu\n", binary, (unsigned long) GetLastError());
        return 2;
    }
#else
    {
        char *absolute = realpath(arguments[1], NULL);
        snprintf(folder, sizeof folder, "%s", absolute ? absolute : arguments[1]);
        free(absolute);
    }
    snprintf(binary, sizeof binary, "%s/%s", folder, BINARY);
    library = dlopen(binary, RTLD_NOW);
    if (library == NULL) {
        printf("%s\n", dlerror());
        return 2;
    }
#endif
    (void) states;
    locate(folder);
    load_functions();
    for (size_t i = 0; i < sizeof calls / sizeof *calls; i++) calls[i]();
    printf("differences: %ld\n", differences);
    return differences ? 1 : 0;
}
