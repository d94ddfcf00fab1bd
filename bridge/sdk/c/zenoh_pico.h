/* zenoh_pico.h: a participant on Zenoh, by zenoh-pico (1.9 or later). Nothing of the protocol is here. */
#ifndef PARTICIPANT_ZENOH_PICO_H
#define PARTICIPANT_ZENOH_PICO_H

#include "participant.h"

/* Runs a participant on Zenoh until its end. Arguments: an endpoint to listen on, one to connect to, "":
 * none. With one to connect to it is a client of the node or router there, and does not listen. Ctrl-C stops
 * it safely. Returns the exit code of the program. */
int run_on_zenoh(int argc, char **argv, const participant_table_t *table, participant_step_t step,
                 void *context);

#endif
