/* entry.c: where VxWorks begins on an emulated board: usrAppInit, and then the tasks that it spawned, each to its end. The result of the
 * run is the first that is not 0 of what these returned. */
#include <vxWorks.h>

#ifdef __cplusplus
extern "C"
#endif
int usrAppInit(void) __attribute__((visibility("hidden")));

typedef int (*task_entry)(intptr_t, intptr_t, intptr_t, intptr_t, intptr_t, intptr_t, intptr_t, intptr_t, intptr_t, intptr_t);

/* The most urgent task that has not run, or -1. */
static int next_task(const struct pulsestage_vx *vx)
{
    int k, next = -1;
    for (k = 0; k < vx->n_tasks; k++)
        if (!vx->tasks[k].taken && (next < 0 || vx->tasks[k].priority < vx->tasks[next].priority))
            next = k;
    return next;
}

PULSESTAGE_MAIN
{
    struct pulsestage_vx *vx = &pulsestage_vx_state;
    int code = usrAppInit(), next, result;
#ifdef PULSESTAGE_VOID_MAIN
    code = 0;
#endif
    while ((next = next_task(vx)) >= 0) {
        const intptr_t *a = vx->tasks[next].arguments;
        vx->tasks[next].taken = 1;
        vx->self = next + 1;
        result = ((task_entry)vx->tasks[next].entry)(a[0], a[1], a[2], a[3], a[4], a[5], a[6], a[7], a[8], a[9]);
        code = code ? code : result;
    }
    fflush(stdout);
    return code;
}
