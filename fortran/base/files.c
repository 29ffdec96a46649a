/* Text files whose write errors are reported. Fortran's run-time library does not report a full
 * disk when it flushes its buffer, so texts that must not be lost are written here.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static const char *finish(int failed) { return failed ? strerror(errno) : NULL; }

/* Open a file for output, either new and empty or with its contents kept. All output of the core is
 * opened here. Anyone who can write to the folder may have put a link or a pipe there; its target
 * must not be written, so such a name is refused. */
const char *rkf_output(const char *path, int keep, int *file)
{
   static _Thread_local char why[120];
   struct stat info;
   const char *what = NULL;
   if (lstat(path, &info) == 0) {
      if (S_ISLNK(info.st_mode)) what = "it is a symbolic link";
      else if (!S_ISREG(info.st_mode)) what = "it is not a regular file";
      else if (keep && info.st_nlink > 1) what = "it is a second name of another file";
      else if (!keep) unlink(path);
   }
   if (what) {
      snprintf(why, sizeof why, "%s; remove it or choose another folder", what);
      return why;
   }
   *file = open(path, O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW | (keep ? 0 : O_EXCL), 0666);
   return finish(*file < 0);
}

/* The same for a library that opens files only by name */
const char *rkf_make(const char *path, int keep)
{
   int number;
   const char *why = rkf_output(path, keep, &number);
   if (!why) close(number);
   return why;
}

const char *rkf_create(const char *path, FILE **file)
{
   int number;
   const char *why = rkf_output(path, 0, &number);
   *file = NULL;
   if (why) return why;
   *file = fdopen(number, "w");
   why = finish(*file == NULL);
   if (why) close(number);
   return why;
}

/* The text has been passed to the operating system when this returns */
const char *rkf_write(FILE *file, const char *text, size_t length)
{
   return finish(fwrite(text, 1, length, file) != length || fflush(file) != 0);
}

const char *rkf_close(FILE *file)
{
   return finish(fclose(file) != 0);
}

const char *rkf_rename(const char *from, const char *to)
{
   return finish(rename(from, to) != 0);
}
