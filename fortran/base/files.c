/* Text files whose failures are told. Fortran's run-time library does not report what a full disk
 * says when it empties its buffer, so texts that must not be lost are written here.
 *
 * Every function returns 0, or -1 with the reason in `why`, a C string cut to `nwhy` characters.
 */
#include <errno.h>
#include <stdio.h>
#include <string.h>

static int finish(int failed, char *why, int nwhy)
{
   snprintf(why, (size_t)nwhy, "%s", failed ? strerror(errno) : "");
   return failed ? -1 : 0;
}

int rkf_create(const char *path, FILE **file, char *why, int nwhy)
{
   *file = fopen(path, "w");
   return finish(*file == NULL, why, nwhy);
}

/* What was written is with the operating system when this returns */
int rkf_write(FILE *file, const char *text, size_t length, char *why, int nwhy)
{
   return finish(fwrite(text, 1, length, file) != length || fflush(file) != 0, why, nwhy);
}

int rkf_close(FILE *file, char *why, int nwhy)
{
   return finish(fclose(file) != 0, why, nwhy);
}

int rkf_rename(const char *from, const char *to, char *why, int nwhy)
{
   return finish(rename(from, to) != 0, why, nwhy);
}
