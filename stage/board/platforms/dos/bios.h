/* bios.h of DOS compilers, on an emulated board. */
#include <dosfunctions.h>
