/* codec.c: the codec called n times, as a tick calls it: no Python in between. */
#include "message.h"

typedef void encode_f(const message_t *, const double *, header_t *, frame_t *);
typedef int32_t decode_f(const message_t *, const frame_t *, double *, header_t *);

API int64_t codec_encode(encode_f *encode, const message_t *m, const double *values, frame_t *frame,
                         int64_t n)
{
    header_t header = {0, 0, 0, 0};
    int64_t i, sum = 0;
    for (i = 0; i < n; i++) {
        header.counter = (uint32_t)i;
        encode(m, values, &header, frame);
        sum += frame->data[0];
    }
    return sum;
}

API int64_t codec_decode(decode_f *decode, const message_t *m, double *values, const frame_t *frame,
                         int64_t n)
{
    header_t header = {0, 0, 0, 0};
    int64_t i, failed = 0;
    for (i = 0; i < n; i++) failed += decode(m, frame, values, &header) != DECODE_OK;
    return failed;
}
