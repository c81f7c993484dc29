#include "heater.h"
P rtP = { 2.0, 0.5 };
