/* new.h on an emulated board: placement new and delete. */
#include <new>
