/* --- Resources ---------------------------------------------------------------------------------------
 *
 * The model reads files in the folder of resources that the host has passed. If FMU_NO_FILES is defined, they are in
 * the program instead.
 */

#ifdef FMU_NO_FILES

typedef struct {
    const char *name;
    const uint8_t *content;
    uint32_t size;
} Resource;

#include "resources.h"

static const Resource *resource_named(const char *name)
{
    size_t k;
    for (k = 0; name && k < sizeof resources / sizeof *resources; ++k)
        if (!strcmp(resources[k].name, name))
            return &resources[k];
    return NULL;
}

/* The size of a resource; UINT32_MAX if there is none with the name. */
uint32_t MODEL(import_resource_size)(Model *model, uint32_t path, uint32_t name)
{
    const Resource *const resource = resource_named(model_string(model, name));
    (void)path;
    return resource ? resource->size : UINT32_MAX;
}

/* Reads a resource of this size. Returns 0 if it could. */
uint32_t MODEL(import_read_resource)(Model *model, uint32_t path, uint32_t name, uint32_t content, uint32_t size)
{
    const Resource *const resource = resource_named(model_string(model, name));
    uint8_t *const bytes = model_bytes(model, content, size);
    (void)path;
    if (!resource || !bytes || resource->size != size)
        return 1;
    memcpy(bytes, resource->content, size);
    return 0;
}

#else

#include <stdio.h>

static FILE *opened(Model *model, uint32_t path)
{
    const char *const file = path ? model_string(model, path) : NULL;
    return file ? fopen(file, "rb") : NULL;
}

/* The size of a resource; UINT32_MAX if it cannot be read. */
uint32_t MODEL(import_resource_size)(Model *model, uint32_t path, uint32_t name)
{
    FILE *const file = opened(model, path);
    long size = -1;
    (void)name;
    if (!file)
        return UINT32_MAX;
    if (!fseek(file, 0, SEEK_END))
        size = ftell(file);
    fclose(file);
    return 0 <= size && size <= INT32_MAX ? (uint32_t)size : UINT32_MAX;
}

/* Reads a resource of this size. Returns 0 if it could. */
uint32_t MODEL(import_read_resource)(Model *model, uint32_t path, uint32_t name, uint32_t content, uint32_t size)
{
    FILE *const file = opened(model, path);
    uint8_t *const bytes = model_bytes(model, content, size);
    size_t read = 0;
    (void)name;
    if (!file)
        return 1;
    if (bytes)
        read = fread(bytes, 1, size, file);
    fclose(file);
    return !bytes || read != size;
}

#endif

