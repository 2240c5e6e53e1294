/* Which of two filtered frames is nearer to the truth, pixel by pixel, and how to mix them.
 *
 * A frame is four planes: three colours and the half difference d that its filter left of the input's: l + d and l - d
 * (l the luminance) are what the filter makes of two independent halves. Each is judged by the half that it has not
 * seen. All is relative to the luminance of the surroundings.
 */
#include "luminance.h"

/* Of noise that the channels share. */
kernel void luminance_variance(CONST_PLANES(variance), int height, int width, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const float deviation = DEVIATION(variance, y, x);
    AT(out, 0, y, x) = deviation * deviation;
}

/* Sum of squares over squared luminance of pure blue, the largest for light. */
#define MOST_COLORED (1.f / (0.0722f * 0.0722f))

/* The sum over the channels of the variance of a filtered frame, from its half difference: one sample a pixel. */
kernel void variance_left(CONST_PLANES(frame), int height, int width, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const float l = LUMINANCE(frame, y, x), d = AT(frame, 3, y, x);
    float squares = 0.f;
    for (int c = 0; c < 3; c++)
        squares += AT(frame, c, y, x) * AT(frame, c, y, x);
    AT(out, 0, y, x) = d * d * smaller(squares / larger(l * l, 1e-12f), MOST_COLORED);
}

/* D r, r within half of D, which is where the truth lies if one of the two is right, and the bound for its noise. */
inline float limited(float change, float beyond, float bound)
{
    const float most = bound + 0.5f * fabs(change);
    return change * clamp(beyond, -most, most);
}

/* out: how much nearer to the truth the candidate is than the middle of the two (g), its square or, if the noise is
 * known pixel by pixel, the variance that this noise gives it, and the squared distance of the two (q).
 *
 * With D what the candidate changes in one half and r how far the other half lies beyond the middle, D r is an unbiased
 * estimate but for two things: filters whose weights come from the whole frame follow a part of its noise (`tracking`),
 * and the halves are noisier than the frame (the last two terms). r is limited to `limit` standard deviations: the
 * noise of few samples has long tails. */
kernel void compare(CONST_PLANES(current), CONST_PLANES(candidate), CONST_PLANES(target), CONST_PLANES(noise),
                    CONST_PLANES(surroundings), int height, int width, float tracking, float limit, int known, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const float l = LUMINANCE(current, y, x), d = AT(current, 3, y, x);
    const float step = LUMINANCE(candidate, y, x) - l, d_step = AT(candidate, 3, y, x) - d;
    const float beyond = LUMINANCE(target, y, x) - l - 0.5f * step;
    const float d_beyond = -AT(target, 3, y, x) - d - 0.5f * d_step;
    const float bound = limit * sqrt(2.f * AT(noise, 0, y, x));
    const float a = limited(step + d_step, beyond + d_beyond, bound);
    const float b = limited(step - d_step, beyond - d_beyond, bound);
    const float g = tracking * AT(noise, 0, y, x) + 0.5f * (a + b) + d_step * d + 0.5f * d_step * d_step;
    const float scaled = relative(g, AT(surroundings, 0, y, x));
    AT(out, 0, y, x) = scaled;
    const float q = relative(step * step, AT(surroundings, 0, y, x));
    AT(out, 1, y, x) = known ? 2.f * q * relative(AT(noise, 0, y, x), AT(surroundings, 0, y, x)) : scaled * scaled;
    AT(out, 2, y, x) = q;
}

/* Frames as near to each other as this, squared and relative, are taken for equal. */
#define DOUBTFUL_DIFFERENCE 1e-10f
#define LEAST_DIFFERENCE 1e-11f
/* Differences of luminances as small as this are nothing unlikely, however dark it is. */
#define FAINT 0.01f

/* current, in place, becomes the mix of the two with the least estimated error; share: the candidate's part in it.
 * found: the planes of `compare`, smoothed. Where they are doubtful the share goes to `prior`; `margin` asks of the
 * candidate to be better by so many standard deviations; `apart` is how far the two may lie apart, in units of the
 * darker one. */
kernel void mix_in(PLANES(current), CONST_PLANES(candidate), CONST_PLANES(found), int height, int width, float prior,
                   float doubt, float margin, float apart, PLANES(share))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const vec zero = (vec)(0.f), one = (vec)(1.f);
    const vec g = VECTOR_AT(found, 0, y, x), q = VECTOR_AT(found, 2, y, x) + LEAST_DIFFERENCE;
    const vec deviation = sqrt(larger(VECTOR_AT(found, 1, y, x) - g * g, zero));
    const vec doubtful = (doubt * deviation + DOUBTFUL_DIFFERENCE) / q, trust = 1.f / (1.f + doubtful * doubtful);
    const vec best = 0.5f + (g - margin * deviation) / q;
    const vec l = VECTOR_LUMINANCE(current, y, x), m = VECTOR_LUMINANCE(candidate, y, x), darker = smaller(l, m);
    const vec step = larger(l, m) - darker;
    const vec believed = BOUNDED(2.f - step / (apart * (larger(darker, zero) + FAINT)), zero, one);
    const vec a = believed * BOUNDED(trust * best + (1.f - trust) * prior, zero, one);
    STORE(a, share + INDEX(share, 0, y, x));
    for (int c = 0; c < 4; c++) {
        const vec before = VECTOR_AT(current, c, y, x), after = VECTOR_AT(candidate, c, y, x);
        STORE(BLEND(before, after, a), current + INDEX(current, c, y, x));
    }
}

/* What each frame contributes to a mix made in the order wide, narrow, input: four planes, input, narrow, the first
 * one and wide, whose sum is 1. */
kernel void parts_of_mix(CONST_PLANES(wide), CONST_PLANES(narrow), CONST_PLANES(input), int height, int width,
                         PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const float w = AT(wide, 0, y, x), n = AT(narrow, 0, y, x), i = AT(input, 0, y, x);
    AT(out, 0, y, x) = i;
    AT(out, 1, y, x) = (1.f - i) * n;
    AT(out, 2, y, x) = (1.f - i) * (1.f - n) * (1.f - w);
    AT(out, 3, y, x) = (1.f - i) * (1.f - n) * w;
}

/* d^2 of a frame: of the input its noise, of a filtered frame the variance that it has left; one sample a pixel. */
kernel void relative_square(CONST_PLANES(frame), CONST_PLANES(surroundings), int height, int width, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const float d = AT(frame, 3, y, x);
    AT(out, 0, y, x) = relative(d * d, AT(surroundings, 0, y, x));
}

/* The relative squared error of a mix of a filtered frame with the input: what the input's noise is beyond what the
 * filter saves of it, but not less than the variance left. found: from comparing the two without a limit; noise and
 * left: relative squares of the input and of the filtered frame; all smoothed. */
kernel void estimated_error(CONST_PLANES(found), CONST_PLANES(noise), CONST_PLANES(left), CONST_PLANES(share),
                            int height, int width, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const float g = AT(found, 0, y, x), q = AT(found, 2, y, x), h = AT(share, 0, y, x);
    const float alone = larger(AT(noise, 0, y, x) + 2.f * g, AT(left, 0, y, x));
    AT(out, 0, y, x) = larger(mix(alone, AT(noise, 0, y, x), h) - h * (1.f - h) * q, 0.f);
}
