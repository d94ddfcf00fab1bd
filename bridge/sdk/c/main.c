/* main.c: node @node@ as a program. Build: @build@
 * Start: ./participant CHANNEL ... (a channel for each bus of table.c). */
#include "linux.h"
#include "table.h"

/* The law, once a slot of h seconds at the time t of the run. Received values are those accepted last. */
static void step(void *context, participant_t *p, double t, double h)
{
    (void)context, (void)t, (void)h, (void)p;
    /* @law@ */
}

int main(int argc, char **argv) { return run_on_can(argc, argv, &TABLE, step, 0); }
