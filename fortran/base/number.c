/* Texts of numbers. */
#define _GNU_SOURCE
#include <locale.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { LONGEST = 40 };

/* Text of a number, padded with blanks: with some significant digits, without trailing zeros; with
 * a power of ten and some digits after the point; or, with 0 digits, the shortest that reads back
 * the same. The decimal sign is a point in any locale of the calling program. */
void rkf_number(double value, int digits, int power, char *text)
{
   static locale_t plain;
   char found[64];
   if (!plain) plain = newlocale(LC_ALL_MASK, "C", (locale_t)0);
   locale_t before = uselocale(plain);
   int n = digits > 0 || power ? digits : 15;
   if (value == 0.0 && digits > 0) value = 0.0;   /* zero has no sign */
   /* whole numbers keep their digits */
   const double size = fabs(value);
   if (digits > 0 && !power && size >= 1.0 && size < 1e5) n = (int)fmax(n, 1.0 + floor(log10(size)));
   do {
      /* infinity as in decks: inf */
      snprintf(found, sizeof found, !isfinite(value) ? "%.*g" : power ? "%.*E" : "%.*G", n, value);
   } while (digits == 0 && !power && n++ < 17 && strtod(found, NULL) != value);
   uselocale(before);
   memset(text, ' ', LONGEST);
   memcpy(text, found, strnlen(found, LONGEST));
}
