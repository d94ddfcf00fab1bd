/* watchdog.c: watchdogs, and presence of peers; see watchdog.h. */
#include "watchdog.h"

#include "life_cycle.h"

API void watchdog_feed(watchdog_t *w, int64_t now_ns)
{
    if (now_ns > w->last_ns) w->last_ns = now_ns;
}

API int32_t watchdog_check(watchdog_t *w, int64_t now_ns)
{
    if (w->latched || w->timeout_ns <= 0) return w->latched;
    if (now_ns - w->last_ns <= w->timeout_ns) return 0;
    w->latched = 1;
    w->trips++;
    return 1;
}

API void watchdog_reset(watchdog_t *w, int64_t now_ns)
{
    w->latched = 0;
    w->last_ns = now_ns;
}

API uint32_t peer_heartbeat(peer_t *peer, int32_t state, uint32_t boots, int64_t now_ns)
{
    const int32_t restarted = peer->state >= 0 && boots != peer->boots;
    peer->state = state;
    peer->boots = boots;
    watchdog_feed(&peer->heartbeat, now_ns);
    peer->heartbeat.latched = 0;
    return restarted && peer->required ? WHY_PEER : 0;
}

API uint32_t peer_check(peer_t *peer, int64_t now_ns)
{
    if (peer->state == LIFE_FINISHED) return 0;
    const int32_t lost = watchdog_check(&peer->heartbeat, now_ns);
    const int32_t stopped = peer->state == LIFE_STOPPING || peer->state == LIFE_FAULT;
    const uint32_t off = peer->takes && peer->state == LIFE_FAULT ? WHY_DRIVE : 0;
    return peer->required && (lost || stopped) ? WHY_PEER | off : 0;
}
