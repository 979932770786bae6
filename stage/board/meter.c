/* What makes computing take time: firmware that is compiled with -fsanitize-coverage=trace-pc calls __sanitizer_cov_trace_pc at each
 * of its basic blocks. This file is compiled without. The bus takes what was counted before each of its requests. */
#include <pulsestage.h>

/* blocks since the last request; with how many the bus is to be turned to, which the host sets */
PULSESTAGE_EXPORT int64_t pulsestage_meter[2] = {0, INT64_MAX};

void __sanitizer_cov_trace_pc(void);
__attribute__((visibility("hidden"))) void __sanitizer_cov_trace_pc(void)
{
    if (++pulsestage_meter[0] >= pulsestage_meter[1])
        ps_spend_ns(0);
}
