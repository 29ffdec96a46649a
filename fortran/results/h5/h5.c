/* HDF5 behind plain C calls, the only file that names H5* routines (used by rk_hdf5.f90).
 *
 * Fortran passes sizes in its own order; they are reversed here, so that a(3,n) becomes an HDF5
 * dataset of shape (n,3) without moving a number. Every function returns NULL, or the reason of its
 * failure, valid until the next call; nothing is printed.
 *
 * Reference: The HDF Group, HDF5 Reference Manual, https://docs.hdfgroup.org (API 1.10)
 */
#include <ISO_Fortran_binding.h>
#include <hdf5.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

/* base/files.c: make a file whose name is neither a link nor a pipe */
const char *rkf_make(const char *path, int keep);

enum { MAX_RANK = 4 };

/* Chunk size of a compressed dataset, small and large [byte] */
static const hsize_t CHUNK_SMALL = 4096, CHUNK_LARGE = 1048576;

/* Bytes if it is not a type of numbers */
static hid_t type_of(CFI_type_t type)
{
   return type == CFI_type_double    ? H5T_NATIVE_DOUBLE
        : type == CFI_type_int64_t   ? H5T_NATIVE_INT64
        : type == CFI_type_int32_t   ? H5T_NATIVE_INT32
                                     : H5T_NATIVE_UINT8;
}

static _Thread_local struct { char text[400]; int heard, quoted; } reason;

/* The innermost error is the most specific; one that quotes the operating system is sufficient. */
static herr_t pick_reason(unsigned n, const H5E_error2_t *entry, void *unused)
{
   (void)unused;
   const char *quote = entry->desc ? strstr(entry->desc, "error message = '") : NULL;
   if (reason.quoted || !entry->desc) return 0;
   if (quote) {
      snprintf(reason.text, sizeof reason.text, "%s", quote + strlen("error message = '"));
      reason.text[strcspn(reason.text, "'")] = '\0';
      reason.quoted = 1;
   } else if (n == 0) {
      snprintf(reason.text, sizeof reason.text, "%s", entry->desc);
   }
   return 0;
}

/* HDF5 calls this when one of its functions fails; the first failure is the reason */
static herr_t hear(hid_t stack, void *unused)
{
   (void)unused;
   if (!reason.heard) H5Ewalk2(stack, H5E_WALK_UPWARD, pick_reason, NULL);
   reason.heard = 1;
   return 0;
}

/* First and last calls of every function that may fail */
static void listen(void)
{
   snprintf(reason.text, sizeof reason.text, "HDF5 gave no reason");
   reason.heard = reason.quoted = 0;
   H5Eset_auto2(H5E_DEFAULT, hear, NULL);
}

static const char *finish(int failed)
{
   H5Eset_auto2(H5E_DEFAULT, NULL, NULL);
   return failed ? reason.text : NULL;
}

/* Open for reading, or create for writing */
const char *rkh5_open(const char *path, int writing, int64_t *file)
{
   struct stat info;
   /* opening a pipe would wait for its other end */
   if (!writing && stat(path, &info) == 0 && !S_ISREG(info.st_mode)) return "it is not a regular file";
   const char *why = writing ? rkf_make(path, 0) : NULL;   /* HDF5 would follow a link */
   if (why) return why;
   H5dont_atexit();   /* a full disk would make the clean-up at exit fail again */
   listen();
   hid_t access = H5Pcreate(H5P_FILE_ACCESS);
   H5Pset_fclose_degree(access, H5F_CLOSE_STRONG);   /* with objects left open on failure */
   H5Pset_file_locking(access, 1, 1);                /* file systems without locks are accepted */
   *file = writing ? H5Fcreate(path, H5F_ACC_TRUNC, H5P_DEFAULT, access)
                   : H5Fopen(path, H5F_ACC_RDONLY, access);
   H5Pclose(access);
   return finish(*file < 0);
}

const char *rkh5_flush(int64_t file)
{
   listen();
   return finish(H5Fflush(file, H5F_SCOPE_LOCAL) < 0);
}

const char *rkh5_close(int64_t file)
{
   listen();
   return finish(H5Fclose(file) < 0);
}

int rkh5_exists(int64_t file, const char *path)
{
   char part[1024];
   size_t length = strlen(path);
   if (length >= sizeof part) return 0;
   for (size_t i = 1; i <= length; i++) {   /* every group on the path must exist as well */
      if (path[i] != '/' && path[i] != '\0') continue;
      memcpy(part, path, i);
      part[i] = '\0';
      if (H5Lexists(file, part, H5P_DEFAULT) <= 0) return 0;
   }
   return 1;
}

/* Chunks contain whole rows (first HDF5 dimension): one append, an even part of a large one, or
 * many small ones. */
static hid_t chunked(int rank, const hsize_t *shape, size_t size)
{
   hsize_t chunk[MAX_RANK], row = size, rows = shape[0] > 0 ? shape[0] : 1;
   for (int i = 1; i < rank; i++) {
      chunk[i] = shape[i];
      row *= shape[i];
   }
   if (row == 0) row = 1;
   if (rows * row < CHUNK_SMALL) {
      rows *= CHUNK_SMALL / (rows * row);
   } else if (rows * row > CHUNK_LARGE) {
      hsize_t pieces = (rows * row + CHUNK_LARGE - 1) / CHUNK_LARGE;
      rows = (rows + pieces - 1) / pieces;
   }
   chunk[0] = rows;
   hid_t layout = H5Pcreate(H5P_DATASET_CREATE);
   H5Pset_chunk(layout, rank, chunk);
   if (H5Zfilter_avail(H5Z_FILTER_DEFLATE) > 0) {
      H5Pset_shuffle(layout);
      H5Pset_deflate(layout, 1);
   }
   return layout;
}

/* Create a dataset without rows, and its parent groups */
static hid_t create_dataset(hid_t file, const char *path, hid_t type, int rank,
   const hsize_t *shape)
{
   hsize_t none[MAX_RANK], most[MAX_RANK];
   memcpy(none, shape, sizeof none);
   memcpy(most, shape, sizeof most);
   none[0] = 0;
   most[0] = H5S_UNLIMITED;
   hid_t space = H5Screate_simple(rank, none, most);
   hid_t layout = chunked(rank, shape, H5Tget_size(type));
   hid_t links = H5Pcreate(H5P_LINK_CREATE);
   H5Pset_create_intermediate_group(links, 1);
   hid_t set = H5Dcreate2(file, path, type, space, links, layout, H5P_DEFAULT);
   H5Pclose(links);
   H5Pclose(layout);
   H5Sclose(space);
   return set;
}

static int append_rows(hid_t set, hid_t type, int rank, const hsize_t *shape, const void *data)
{
   hsize_t size[MAX_RANK], start[MAX_RANK] = {0};
   hid_t space = H5Dget_space(set);
   if (H5Sget_simple_extent_ndims(space) != rank) {
      H5Sclose(space);
      return -1;
   }
   H5Sget_simple_extent_dims(space, size, NULL);
   H5Sclose(space);
   for (int i = 1; i < rank; i++) {
      if (size[i] != shape[i]) return -1;
   }
   start[0] = size[0];
   size[0] += shape[0];
   if (H5Dset_extent(set, size) < 0) return -1;
   space = H5Dget_space(set);
   hid_t memory = H5Screate_simple(rank, shape, NULL);
   int failed = H5Sselect_hyperslab(space, H5S_SELECT_SET, start, NULL, shape, NULL) < 0
      || H5Dwrite(set, type, memory, space, H5P_DEFAULT, data) < 0;
   H5Sclose(memory);
   H5Sclose(space);
   return failed ? -1 : 0;
}

/* Append rows to those present; the first call creates the dataset */
const char *rkh5_append(int64_t file, const char *path, const CFI_cdesc_t *values)
{
   hsize_t shape[MAX_RANK] = {0};
   const int rank = values->rank;
   listen();
   const hid_t type = type_of(values->type);
   for (int i = 0; i < rank && i < MAX_RANK; i++)
      shape[i] = (hsize_t)values->dim[rank - 1 - i].extent;
   hid_t set = rkh5_exists(file, path) ? H5Dopen2(file, path, H5P_DEFAULT)
                                       : create_dataset(file, path, type, rank, shape);
   int failed = set < 0 || append_rows(set, type, rank, shape, values->base_addr) < 0;
   if (set >= 0 && H5Dclose(set) < 0) failed = 1;
   return finish(failed);
}

/* Report an error of this file instead of one of the library */
static void complain(const char *text)
{
   snprintf(reason.text, sizeof reason.text, "%s", text);
   reason.heard = 1;
}

/* Whether the numbers of a dataset can be read as reals, or as integers: integers may be read as
 * reals, the reverse would lose digits */
static int fits(hid_t set, int real)
{
   hid_t type = H5Dget_type(set);
   H5T_class_t class = type < 0 ? H5T_NO_CLASS : H5Tget_class(type);
   if (type >= 0) H5Tclose(type);
   if (class == H5T_INTEGER || (class == H5T_FLOAT && real)) return 1;
   complain(real ? "it does not hold numbers" : "it does not hold integers");
   return 0;
}

/* Whether a dataset stores as much as its shape requires. Deflate shrinks by a factor of 1032 at
 * most; a damaged header may declare more than fits into memory. */
static int is_backed(hid_t set, hid_t space)
{
   hid_t type = H5Dget_type(set);
   double claimed = (double)H5Tget_size(type), stored = (double)H5Dget_storage_size(set);
   hsize_t shape[H5S_MAX_RANK];
   int rank = H5Sget_simple_extent_dims(space, shape, NULL);
   H5Tclose(type);
   for (int i = 0; i < rank; i++) claimed *= (double)shape[i];
   if (claimed <= 1100.0 * stored) return 1;
   complain("its shape declares far more numbers than the file contains");
   return 0;
}

/* All numbers of a dataset, converted to the kind of an array allocated here with its shape */
const char *rkh5_read(int64_t file, const char *path, CFI_cdesc_t *values)
{
   hsize_t shape[H5S_MAX_RANK];
   CFI_index_t first[MAX_RANK] = {1, 1, 1, 1}, last[MAX_RANK];
   const int wanted = values->rank;
   if (!rkh5_exists(file, path)) return "it is missing";
   listen();
   hid_t set = H5Dopen2(file, path, H5P_DEFAULT);
   hid_t space = set < 0 ? -1 : H5Dget_space(set);
   int rank = -1;
   if (space >= 0 && fits(set, values->type == CFI_type_double) && is_backed(set, space))
      rank = H5Sget_simple_extent_dims(space, shape, NULL);
   int failed = rank != wanted;
   if (rank >= 0 && failed) {
      snprintf(reason.text, sizeof reason.text, "it has %d dimension(s), but %d are needed", rank,
               wanted);
      reason.heard = 1;
   }
   for (int i = 0; !failed && i < rank; i++) last[i] = (CFI_index_t)shape[rank - 1 - i];
   if (!failed && CFI_allocate(values, first, last, 0) != CFI_SUCCESS) {
      complain("there is no memory for it");
      failed = 1;
   }
   if (!failed)
      failed = H5Dread(set, type_of(values->type), H5S_ALL, H5S_ALL, H5P_DEFAULT,
                       values->base_addr) < 0;
   if (space >= 0) H5Sclose(space);
   if (set >= 0) H5Dclose(set);
   return finish(failed);
}

/* Set an attribute of a group or dataset. Bytes become a text of fixed length and ASCII kind, the
 * only one that all VTK readers accept; one number becomes a scalar, several become a list. */
const char *rkh5_put_attribute(int64_t file, const char *object, const char *name,
   const CFI_cdesc_t *values)
{
   listen();
   hsize_t size = (hsize_t)values->dim[0].extent;
   const int text = type_of(values->type) == H5T_NATIVE_UINT8, scalar = size == 1 || text;
   hid_t space = scalar ? H5Screate(H5S_SCALAR) : H5Screate_simple(1, &size, NULL);
   hid_t type = H5Tcopy(text ? H5T_C_S1 : type_of(values->type));
   if (text) {
      H5Tset_size(type, size);
      H5Tset_strpad(type, H5T_STR_NULLPAD);
   }
   hid_t owner = H5Oopen(file, object, H5P_DEFAULT);   /* H5Aopen_by_name cannot be written to */
   hid_t attribute = -1;
   if (owner >= 0) attribute = H5Aexists(owner, name) > 0
      ? H5Aopen(owner, name, H5P_DEFAULT)
      : H5Acreate2(owner, name, type, space, H5P_DEFAULT, H5P_DEFAULT);
   int failed = attribute < 0 || H5Awrite(attribute, type, values->base_addr) < 0;
   if (attribute >= 0) H5Aclose(attribute);
   if (owner >= 0) H5Oclose(owner);
   H5Tclose(type);
   H5Sclose(space);
   return finish(failed);
}
