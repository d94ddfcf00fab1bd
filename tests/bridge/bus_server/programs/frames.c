/* frames.c: two raw sockets of AF_CAN; prints the time of each frame (ns since the start of 2026), whether it
 * is the socket's own, and the frame. */
#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#define DATE 1767225600LL

static int opened(const char *name)
{
    const int fd = socket(PF_CAN, SOCK_RAW, CAN_RAW), on = 1;
    struct ifreq about;
    struct sockaddr_can to;

    memset(&about, 0, sizeof about);
    memset(&to, 0, sizeof to);
    strncpy(about.ifr_name, name, IFNAMSIZ - 1);
    if (fd < 0 || ioctl(fd, SIOCGIFINDEX, &about) < 0) return -1;
    to.can_family = AF_CAN;
    to.can_ifindex = about.ifr_ifindex;
    if (setsockopt(fd, SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof on) < 0) return -1;
    return bind(fd, (struct sockaddr *)&to, sizeof to) < 0 ? -1 : fd;
}

static void show(const char *who, int fd)
{
    char room[CMSG_SPACE(sizeof(struct timespec))];
    struct pollfd file = {fd, POLLIN, 0};
    struct can_frame frame;
    struct iovec part = {&frame, sizeof frame};
    struct msghdr message;
    struct timespec t;
    int i;

    while (poll(&file, 1, 5) == 1) {
        memset(&message, 0, sizeof message);
        message.msg_iov = &part;
        message.msg_iovlen = 1;
        message.msg_control = room;
        message.msg_controllen = sizeof room;
        if (recvmsg(fd, &message, 0) != sizeof frame) return;
        memcpy(&t, CMSG_DATA(CMSG_FIRSTHDR(&message)), sizeof t);
        printf("%s %lld %d %X#", who, (t.tv_sec - DATE) * 1000000000LL + t.tv_nsec,
               (message.msg_flags & MSG_CONFIRM) != 0, frame.can_id);
        for (i = 0; i < frame.can_dlc; i++) printf("%02X", frame.data[i]);
        printf("\n");
    }
}

int main(void)
{
    const int a = opened("can0"), b = opened("can0"), on = 1;
    const struct can_filter even = {0x100, 0x701};
    struct can_frame frame = {.can_id = 0x300, .can_dlc = 0};

    printf("other %d\n", opened("can1"));
    setsockopt(a, SOL_CAN_RAW, CAN_RAW_RECV_OWN_MSGS, &on, sizeof on);
    setsockopt(b, SOL_CAN_RAW, CAN_RAW_FILTER, &even, sizeof even);
    usleep(1000);
    if (write(a, &frame, sizeof frame) != sizeof frame) return 1;
    frame.can_id = 0x101;
    if (write(a, &frame, sizeof frame) != sizeof frame) return 1;
    frame.can_id = 0x102;
    frame.can_dlc = 8;
    memset(frame.data, 0x55, 8);
    if (send(a, &frame, sizeof frame, 0) != sizeof frame) return 1;
    show("a", a);
    show("b", b);
    return 0;
}
