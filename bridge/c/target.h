/* target.h: the memory that a node has for the traffic of its buses.
 *
 * With NODE_FIRMWARE it is a node on a microcontroller: CAN alone, counts instead of histograms, one
 * processor and one thread, so that nothing else looks at a journal while it is written.
 */
#ifndef BRIDGE_TARGET_H
#define BRIDGE_TARGET_H

/* FRAME_DATA: bytes of a frame; MESSAGE_FIELDS: the most values a message may have; BUS_BATCH: frames that
 * one call to the kernel gives; PACE_BINS: of a histogram, 1 us to 1024 us, then doubling with 64 a factor
 * of two. */
#if defined(NODE_FIRMWARE)
enum { FRAME_DATA = 64, MESSAGE_FIELDS = 64, BUS_BATCH = 1, PACE_BINS = 1 };
#define SHARED_LOAD(place, order) (*(place))
#define SHARED_STORE(place, value, order) (*(place) = (value))
#else
enum { FRAME_DATA = 232, MESSAGE_FIELDS = 256, BUS_BATCH = 8, PACE_BINS = 2048 };
#define SHARED_LOAD(place, order) __atomic_load_n(place, order)
#define SHARED_STORE(place, value, order) __atomic_store_n(place, value, order)
#endif

#endif
