/* Linked into the sanitized programs: libraries stay loaded, so that the leak sanitizer can name the module of each
   leak at the end. A GL driver is unloaded when its display is terminated; its leaks would then be in an "unknown
   module". */
int dlclose(void *library);
int dlclose(void *library) { return (void)library, 0; }
