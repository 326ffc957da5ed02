// Work that is asked for more often than it can be done.

/** Does some work, once at a time; what is asked for meanwhile is done once, afterwards. */
export function oneAtATime(work) {
  let [isBusy, isAsked] = [false, false];
  return async () => {
    isAsked = true;
    if (isBusy) return;
    isBusy = true;
    try {
      while (isAsked) {
        isAsked = false;
        await work();
      }
    } finally {
      isBusy = false;
    }
  };
}
