/* Linked into the sanitized programs: libraries stay loaded, so that the leak sanitizer can still tell at the end whose
   a piece of memory was. A GL driver is unloaded when its display is terminated, and what it leaks would come from an
   "unknown module". */
int dlclose(void *library);
int dlclose(void *library) { return (void)library, 0; }
