/* can.h: CAN sockets and timer files of a program, which are connections to the simulated bus. */
#ifndef PRELOAD_CAN_H
#define PRELOAD_CAN_H

#include <sys/socket.h>
#include <sys/types.h>

/* True for a socket that the program has opened as one of AF_CAN, or a file of timerfd_create. */
int is_can(int fd);
/* Receive a frame, as recvmsg from a raw socket of AF_CAN, or how often a timer has expired. */
ssize_t can_receive(int fd, struct msghdr *to, int flags);
/* Send a frame, as sendmsg to it. */
ssize_t can_send(int fd, const struct msghdr *from, int flags);

#endif
