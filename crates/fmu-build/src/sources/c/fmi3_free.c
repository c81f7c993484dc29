FMI3_Export void fmi3FreeInstance(fmi3Instance instance)
{
    free_instance(instance);
}

