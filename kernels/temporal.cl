/* Neighbouring frames of a sequence merged into a frame, before any method sees it.
 *
 *   c'(p) = (c(p) + sum_k w_k(p) sum_i t_i c_k(q_i)) / (1 + sum_k w_k(p)),   v'(p) = (v(p) + sum w^2 t^2 v) / (...)^2
 *
 * q_i are the four pixels of neighbour k around the place to which p has moved, which motion.cl has found. Each of the
 * four, each pixel and its surroundings are tested: what differs in its features is left out. What differs in light by
 * more than its noise V gets the weight of least error, V / (V + B), B the squared difference that noise does not
 * explain. All frames are laid out alike, without borders.
 *
 * A guide holds the planes of the features, then for each feature the sum of its channels' variances. Light is three
 * planes of colour, outliers held back, and the sum of their variances.
 */
#include "mismatch.h"
#include "moved.h"

/* Each of the four pixels: kept up to FIRST, left out from LAST on, with a smooth step between; the pixel with all of
 * them, as a mean over 3x3. */
#define TAP_FIRST 1.f
#define TAP_LAST 4.f
#define PIXEL_FIRST 1.f
#define PIXEL_LAST 3.f
/* Each of the four with a doubt that shrinks by STAKE times what it would cost to take the one for the other: a pixel of
 * wall, and one that a lamp a hundred times as bright has a part in. */
#define EDGE_FIRST 4.f
#define EDGE_LAST 12.f
#define STAKE 0.1f
/* Its light alone: squared difference over noise. */
#define SPIKE_FIRST 16.f
#define SPIKE_LAST 36.f
/* Light is relative to the darker of two pixels, as errors are, but not to less than this, squared. */
#define DARK2 0.01f
/* A mean that differs by two standard deviations may do so by chance. */
#define CHANCE 4.f

INLINE vec kept(vec x, float first, float last)
{
    const vec t = BOUNDED((last - x) * (1.f / (last - first)), (vec)(0.f), (vec)(1.f));
    return t * t * (3.f - 2.f * t);
}

#define HERE(c) here[c]
#define THERE(c) there[c]
#define STRICT(c) strict[c]
#define LIGHT(c) VECTOR_AT(light, c, y, x)
#define LIGHT_THERE(c) light_there[c]

/* What squared differences of light are relative to: 1 over the square of the darker of two. */
#define MEAN3(A) ((A(0) + A(1) + A(2)) / 3.f)
#define RELATIVE(A, B) (1.f / (SQUARE(smaller(fabs(MEAN3(A)), fabs(MEAN3(B)))) + DARK2))

/* Eight planes of tests: the mismatch of a pixel and what has become of it; their squared difference in light and its
 * variance, relative to the darker of the two, and as they are; the relative difference of each channel. And the weights
 * of the four pixels: their sum is 1, or less. */
kernel void compare(CONST_PLANES(own), CONST_PLANES(other), CONST_PLANES(light), CONST_PLANES(other_light),
                    CONST_PLANES(motion), int block, int height, int width, PLANES(tests), PLANES(weights))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    Moved m;
    MOVED(m);
    const vec zero = (vec)(0.f);
    vec here[GUIDE], there[GUIDE], strict[GUIDE], light_there[4], weight[4], sum = zero, same = zero;
    vec guides[4 * GUIDE], lights[4 * 4];
    MOVED_TO(other, 0, GUIDE, guides);
    MOVED_TO(other_light, 0, 4, lights);
    for (int c = 0; c < GUIDE; c++)
        strict[c] = here[c] = VECTOR_AT(own, c, y, x);
    for (int i = 0; i < 4; i++) {
        for (int c = 0; c < GUIDE; c++)
            there[c] = guides[i * GUIDE + c];
        for (int c = 0; c < 3; c++)
            light_there[c] = lights[i * 4 + c];
        const vec alike = kept(MISMATCH(HERE, THERE), TAP_FIRST, TAP_LAST);
        /* Where the one is all of a piece and the other is not, the doubt is between the variances of both. */
        const vec doubt = 1.f / (1.f + STAKE * SQUARES3(LIGHT, LIGHT_THERE, 0) * RELATIVE(LIGHT, LIGHT_THERE));
        for (int c = CHANNELS; c < GUIDE; c++) {
            const vec least = smaller(here[c], there[c]);
            strict[c] = BLEND(least, here[c], doubt);
            there[c] = BLEND(least, there[c], doubt);
        }
        const vec same_thing = kept(MISMATCH(STRICT, THERE), EDGE_FIRST, EDGE_LAST);
        same += m.weight[i] * same_thing;
        weight[i] = m.weight[i] * (1e-3f + alike * same_thing);
        sum += weight[i];
    }
    const vec scale = 1.f / (sum > zero ? sum : (vec)(1.f));
    for (int i = 0; i < 4; i++)
        weight[i] *= scale;
    /* What the four make: means, and the variances of them. */
    for (int c = 0; c < GUIDE; c++) {
        there[c] = zero;
        for (int i = 0; i < 4; i++)
            there[c] += (c < CHANNELS ? weight[i] : weight[i] * weight[i]) * guides[i * GUIDE + c];
    }
    for (int c = 0; c < 4; c++) {
        light_there[c] = zero;
        for (int i = 0; i < 4; i++)
            light_there[c] += (c < 3 ? weight[i] : weight[i] * weight[i]) * lights[i * 4 + c];
    }
    const vec squares = SQUARES3(LIGHT, LIGHT_THERE, 0), noise = LIGHT(3) + light_there[3];
    const vec relative = RELATIVE(LIGHT, LIGHT_THERE), size = sqrt(relative);
    same *= kept(squares / (noise + 1e-9f), SPIKE_FIRST, SPIKE_LAST);
    const vec mismatch = smaller(MISMATCH(HERE, THERE), (vec)(MOST));
    const vec test[] = {sum > zero ? mismatch : (vec)(MOST), relative * squares, relative * noise, squares, noise,
                        size * (LIGHT(0) - light_there[0]), size * (LIGHT(1) - light_there[1]),
                        size * (LIGHT(2) - light_there[2])};
    for (int c = 0; c < 8; c++)
        STREAM(c == 0 || sum > zero ? test[c] : zero, tests + INDEX(tests, c, y, x));
    for (int i = 0; i < 4; i++)
        STORE(same * weight[i], weights + INDEX(weights, i, y, x));
}

/* In place: the weights of the four pixels times that of what they make. The sum of the weights of all frames grows by
 * it. The mismatch comes as its mean over 3x3, the tests of light over PIXELS.
 *
 * noise = 2 V, so excess over noise is B / 2V. Noise averages out further on, in whatever filter comes next, but a
 * difference that the whole surroundings share does not, so it counts as often as there are pixels. */
kernel void weigh(CONST_PLANES(mismatch), CONST_PLANES(light), int height, int width, PLANES(weights), PLANES(total))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const vec zero = (vec)(0.f), noise = LIGHT(1) + 1e-9f, plain_noise = LIGHT(3) + 1e-9f;
    const vec excess = larger(LIGHT(0) / noise, LIGHT(2) / plain_noise) - 1.f;
    const vec shared = (SQUARE(LIGHT(4)) + SQUARE(LIGHT(5)) + SQUARE(LIGHT(6))) * (PIXELS / noise);
    const vec w = kept(VECTOR_AT(mismatch, 0, y, x), PIXEL_FIRST, PIXEL_LAST) /
                  (1.f + 2.f * (larger(excess, zero) + larger(shared - CHANCE, zero)));
    vec sum = zero;
    for (int i = 0; i < 4; i++) {
        const vec weight = w * VECTOR_AT(weights, i, y, x);
        STORE(weight, weights + INDEX(weights, i, y, x));
        sum += weight;
    }
    STORE(VECTOR_AT(total, 0, y, x) + sum, total + INDEX(total, 0, y, x));
}

/* In place: sum grows by a plane of the other frame, with these weights or, of variances, their squares. Of light,
 * what was held back of an outlier (factor: what was left of each pixel) is not spread over four pixels but stays one,
 * so that it can be told from light. A variance below 0 is not known, and neither is its sum. */
kernel void accumulate(CONST_PLANES(other), CONST_PLANES(factor), CONST_PLANES(weights), CONST_PLANES(motion),
                       int block, int channels, int height, int width, int squared, int light, PLANES(sum))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const vec zero = (vec)(0.f), one = (vec)(1.f);
    vec part[4], all = zero, left = one;
    whole used[4], nearer[4];
    for (int i = 0; i < 4; i++) {
        part[i] = VECTOR_AT(weights, i, y, x);
        used[i] = part[i] > zero;
        all += part[i];
    }
    const whole some = all > zero;
    if (!ANY(some))
        return;
    Moved m;
    MOVED(m);
    nearer_ones(&m, nearer);
    if (light) {
        vec factors[4];
        MOVED_TO(factor, 0, 1, factors);
        for (int i = 0; i < 4; i++) {
            left = nearer[i] ? factors[i] : left;
            part[i] *= factors[i];
        }
    }
    vec held = all * (one - left);
    if (squared) {
        held = all * all * (one - left * left);
        for (int i = 0; i < 4; i++)
            part[i] *= part[i];
    }
    for (int c = 0; c < channels; c++) {
        const vec before = VECTOR_AT(sum, c, y, x);
        vec values[4], gained = zero, nearest = zero, least = before;
        MOVED_TO(other, c, 1, values);
        for (int i = 0; i < 4; i++) {
            gained += part[i] * values[i];
            nearest = nearer[i] ? values[i] : nearest;
            least = used[i] ? smaller(least, values[i]) : least;
        }
        if (light) {
            gained += held * nearest;
            least = smaller(least, nearest);
        }
        const vec after = squared ? (least < zero ? (vec)(-1.f) : before + gained) : before + gained;
        STORE(some ? after : before, sum + INDEX(sum, c, y, x));
    }
}

/* out = sum / total, or, of variances, over its square. */
kernel void normalise(CONST_PLANES(sum), CONST_PLANES(total), int height, int width, int squared, PLANES(out))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    const vec all = VECTOR_AT(total, 0, y, x), value = VECTOR_AT(sum, c, y, x), square = value * (1.f / (all * all));
    const vec mean = squared ? (value < (vec)(0.f) ? (vec)(-1.f) : square) : value / all;
    STREAM(mean, out + INDEX(out, c, y, x));
}
