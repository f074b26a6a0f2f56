// Saved maps in the browser's storage (IndexedDB), one for each camera.

/** @returns {Promise<IDBDatabase>} */
function opened() {
  return new Promise((resolve, reject) => {
    const request = indexedDB.open('pocket-ptam', 1);
    request.onupgradeneeded = () => request.result.createObjectStore('maps');
    request.onsuccess = () => resolve(request.result);
    request.onerror = () => reject(request.error);
  });
}

/**
 * @template T @param {'readonly'|'readwrite'} mode @param {(maps: IDBObjectStore) => IDBRequest<T>} work
 * @returns {Promise<T>}
 */
async function inStore(mode, work) {
  const database = await opened();
  try {
    return await new Promise((resolve, reject) => {
      const transaction = database.transaction('maps', mode);
      const request = work(transaction.objectStore('maps'));
      transaction.oncomplete = () => resolve(request.result);
      transaction.onabort = transaction.onerror = () => reject(transaction.error);
    });
  } finally {
    database.close();
  }
}

/** @param {string} camera @param {Uint8Array} file */
export const keepMap = (camera, file) => inStore('readwrite', (maps) => maps.put(file, camera));

/** @param {string} camera @returns {Promise<Uint8Array|undefined>} */
export const keptMap = (camera) => inStore('readonly', (maps) => maps.get(camera));
