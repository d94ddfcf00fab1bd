/* linux.h: a participant on Linux: its clock, and a loop on CAN. Nothing of the protocol is here.
 *
 * A channel is the name of a SocketCAN interface (vcan0), or the address of a simulated bus that `cosim bus`
 * or `cosim rehearse -i cosim` serves (NAME@HOST:PORT).
 */
#ifndef PARTICIPANT_LINUX_H
#define PARTICIPANT_LINUX_H

#include "participant.h"

int64_t linux_now_ns(void); /* CLOCK_MONOTONIC */

/* A participant that was initialized gets the clock of this host; from then on Ctrl-C and SIGTERM stop it. */
void linux_begin(participant_t *p);
/* participant_poll now, with signals and the date of the host. */
int64_t linux_poll(participant_t *p);
/* Prints how it ended to standard error. Returns the exit code of the program: 0 finished, 1 stopped. */
int linux_end(const participant_t *p);

/* Runs a participant on CAN until its end. Arguments: a channel for each bus of the table, in its order, or
 * BUS=CHANNEL. Ctrl-C stops it safely. Returns the exit code of the program. */
int run_on_can(int argc, char **argv, const participant_table_t *table, participant_step_t step,
               void *context);

#endif
