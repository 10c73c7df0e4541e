/* Compiled only to read the size of the firmware's state off the object file. */
#include "app/app.h"

app_t size_probe;
