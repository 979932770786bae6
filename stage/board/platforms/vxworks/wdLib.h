/* wdLib.h of VxWorks, on an emulated board. */
#include <vxWorks.h>
