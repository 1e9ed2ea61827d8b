/* Linked into the sanitized programs so that libraries stay loaded, and the leak sanitizer can name the module of each
   leak at the end. Otherwise a GL driver would be unloaded when its display is terminated, and its leaks would be in an
   "unknown module". */
int dlclose(void *library);
int dlclose(void *library) { return (void)library, 0; }
