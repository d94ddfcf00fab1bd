/* linux.h: a participant on Linux: its clock, and a loop on CAN. Nothing of the protocol is here.
 *
 * A channel is the name of a SocketCAN interface (vcan0), or the address of a simulated bus that `cosim bus`
 * or `cosim rehearse -i cosim` serves (NAME@HOST:PORT).
 */
#ifndef PARTICIPANT_LINUX_H
#define PARTICIPANT_LINUX_H

#include "participant.h"

int64_t linux_now_ns(void);                    /* CLOCK_MONOTONIC */
void linux_host(participant_host_t *host);     /* fills in the clock of this host */
void linux_set_date(participant_host_t *host); /* its date_offset_ns anew */
uint32_t linux_boots(void);                    /* another number for each start, 1 to 4095 */

/* Runs a participant on CAN until its end. Arguments: a channel for each bus of the table, in its order, or
 * BUS=CHANNEL. Ctrl-C stops it safely. Returns the exit code of the program. */
int run_on_can(int argc, char **argv, const participant_table_t *table, participant_step_t step,
               void *context);

#endif
